import pytest

from benchmarks.bench_page import ASSETS, BOUND, ratio_chart, render_bench
from roadsight.report.files import read_assets

ROW = {
    "kernel": "ground filter", "ours": "pillars", "against": "lowest <point>", "cpu_s_ours": 0.5,
    "cpu_s_against": 5.0, "ratio": 10.0, "peak_mib_ours": 12.0, "peak_mib_against": None,
    "agreement": 0.99, "agreement_metric": "share of equal labels", "workload": "1000 points",
}  # fmt: skip


def page(rows):
    assets = read_assets(ASSETS)
    return render_bench(rows, assets, "1.0", "x86_64")


def test_peers_and_bounds_have_tables_of_their_own() -> None:
    bound = ROW | {"kernel": "voxels", "against": f"{BOUND}decoding", "ratio": 0.25}
    html = page([ROW, bound])
    peers, bounds = html.split("How far from the bound")
    assert "lowest &lt;point&gt;" in peers
    assert "ground filter" in peers
    assert "voxels" not in peers
    assert "decoding" in bounds
    assert ">4<" in bounds  # four times the bound
    assert page([ROW, bound]) == html
    assert ">2.5<" in page([bound | {"wall_s_ours": 5.0, "wall_s_against": 2.0}])  # by the clock


@pytest.mark.parametrize("rows", [[], [ROW | {"agreement": None}], [ROW | {"ratio": 0.0}]])
def test_rows_that_know_little(rows) -> None:
    assert page(rows).startswith("<!doctype html>")


@pytest.mark.parametrize(("ratio", "kind"), [(0.02, "slower"), (1.0, "faster"), (5e4, "faster")])
def test_bars_grow_from_one(ratio, kind) -> None:
    chart = ratio_chart([ROW | {"ratio": ratio}])
    assert f'class="{kind}"' in chart
    assert 'width="-' not in chart
