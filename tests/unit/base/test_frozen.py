import json

import pytest

from tests import frozen


@pytest.fixture
def results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, content in {
        "sample/placement/os-64/solution.json": "{}",
        "sample/benchmarks/build_dem.tsv": "1.0",
        "truth/truth.csv": "area,dataset,metric,ours,peer,published,goal,cpu_s\n"
        "ground,a,f1,96,,,95,3",
        "bench/bench.json": json.dumps(
            [{"kernel": "dem", "against": "numpy", "agreement": 0.5, "agreement_metric": "m"}]
        ),
    }.items():
        path = tmp_path / "results" / name
        path.parent.mkdir(parents=True)
        path.write_text(content)
    assert frozen.main("kept.json") == 0
    return tmp_path / "results"


@pytest.mark.parametrize(
    ("name", "before", "after", "told"),
    [
        ("sample/placement/os-64/solution.json", "{}", "[]", "results/sample/placement/os-64"),
        ("truth/truth.csv", "96", "95", "truth ground a f1: 96   95 -> 95   95"),
        ("bench/bench.json", "0.5", "0.4", "bench dem against numpy: m 0.5 -> m 0.4"),
    ],
)
def test_what_changes_is_told(results, capsys, name, before, after, told):
    assert frozen.main("kept.json") == 0
    path = results / name
    path.write_text(path.read_text().replace(before, after))
    assert frozen.main("kept.json") == 1
    assert told in capsys.readouterr().out


def test_times_do_not_count(results):
    (results / "sample/benchmarks/build_dem.tsv").write_text("2.0")
    table = results / "truth/truth.csv"
    table.write_text(table.read_text().replace(",3", ",4"))
    assert frozen.main("kept.json") == 0
