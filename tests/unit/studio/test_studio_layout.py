import numpy as np
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.studio.layout import Layouts, WhatIf
from roadsight.studio.project import Project
from tests.helpers.report_site import ReportSite
from tests.helpers.small_workflow import without_sites

SETTINGS = {"shards": 1, "coverage": {"shards": 1, "uncoverable": "exclude"}}
PLAN = "puck-32c-or-os-32"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = without_sites(tmp_path_factory.mktemp("project"))
    site = {"site": "tiny", "jobs": ["placement"], "clouds": ["x.laz"], "settings": SETTINGS}
    (root / "config/sites/tiny.yaml").write_text(yaml.safe_dump(site))
    ReportSite(root / "results", "tiny", hidden=0.1)
    return root


@pytest.fixture
def layouts(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return Layouts(Project(folder))


def test_the_plan_itself_neither_loses_nor_gains(layouts):
    about = layouts.of("tiny", PLAN).about()
    coverage, solution = about["coverage"], about["solution"]
    assert (coverage["lost"], coverage["gained"]) == (0, 0)
    assert coverage["covered"] == solution["covered_targets"]
    assert coverage["cost"] == sum(
        about["sensors"][about["choices"]["sensor"][row]]["cost"] for row in about["chosen"]
    )
    assert coverage["next"] is None and sum(n > 0 for n in coverage["needs"]) == len(
        about["uncovered"]
    )


def test_any_set_is_counted_as_pair_by_pair(layouts):
    layout = layouts.of("tiny", PLAN)
    dense = layout.matrix.toarray()
    rng = np.random.default_rng(3)
    position = layout.choices["position"].to_numpy()
    before = dense[layout.chosen].sum(axis=0) >= layout.needed
    for size in (0, 1, 3, 6):
        rows = rng.permutation(len(dense))
        rows = rows[np.sort(np.unique(position[rows], return_index=True)[1])][:size]
        found = layout.coverage(rows)
        times = dense[rows].sum(axis=0)
        covered = times >= layout.needed
        assert found["times"] == times.tolist() and found["covered"] == covered.sum()
        assert found["lost"] == (before & ~covered).sum()
        assert found["gained"] == (covered & ~before).sum()
        for row, only in zip(rows, found["only"], strict=True):
            without = dense[rows[rows != row]].sum(axis=0) >= layout.needed
            assert only == (covered & ~without).sum()
        free = ~np.isin(position, position[rows])
        gains = np.where(free, (dense & ~covered).sum(axis=1), 0)
        assert found["next_covers"] == gains.max()
        assert (found["next"] is None) == (gains.max() == 0)
        assert found["next"] is None or gains[found["next"]] == gains.max()


def test_what_makes_no_sense_is_refused(layouts):
    layout = layouts.of("tiny", PLAN)
    position = layout.choices["position"].to_numpy()
    twins = np.flatnonzero(position == position[0])
    assert len(twins) == 2
    with pytest.raises(InputError, match="two sensors at one position"):
        layout.coverage(twins)
    with pytest.raises(InputError, match="no such candidate"):
        layout.coverage(np.array([len(position)]))
    with pytest.raises(InputError, match="computed anew"):
        layouts.coverage("tiny", PLAN, WhatIf(version="old", rows=[]))
    with pytest.raises(InputError, match="no such plan"):
        layouts.of("tiny", "../os-32")


def test_a_plan_is_read_again_when_it_changes_and_told_when_broken(layouts, folder):
    path = folder / "results/tiny/placement/os-32/solution.json"
    before = path.read_text()
    first = layouts.of("tiny", "os-32")
    assert layouts.of("tiny", "os-32") is first
    path.write_text(before.replace('"at_least": 1', '"at_least": 2'))
    again = layouts.of("tiny", "os-32")
    assert again is not first and (again.needed == 2).all()
    path.write_text(before.replace("-h06", "-h99").replace("-h04", "-h99"))
    with pytest.raises(InputError, match="no candidates any more"):
        layouts.of("tiny", "os-32")
    path.write_text(before)
    shard = folder / "results/tiny/placement/round-0/detection/OS1-64/0.parquet"
    shard.rename(shard.with_suffix(".away"))
    with pytest.raises(InputError, match="is not there yet"):
        layouts.of("tiny", "os-64")
    shard.with_suffix(".away").rename(shard)
