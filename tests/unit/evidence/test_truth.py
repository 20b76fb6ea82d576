import math

import numpy as np
import pandas as pd
import pytest

from roadsight.evidence.labelled_clouds import f1
from roadsight.evidence.truth_catalogue import (
    AREAS,
    COLUMNS,
    MEAN,
    Area,
    Figure,
    Metric,
    holds,
    truth_rows,
)
from roadsight.report.files import read_assets
from roadsight.report.truth_page import ASSETS, render_truth
from roadsight.stages.truth.truth_ground import kappa, smrf

AREA = Area(
    title="Things",
    peer="others",
    datasets={"a": ("a.txt",), "b": ("b.txt", "c/*.txt")},
    metrics={"error": Metric("%", published=5.0, goal="<4", each="<6"), "count": Metric("1")},
)


def rows(measured):
    return truth_rows("things", AREA, measured)


class TestTable:
    def test_a_row_a_data_set_and_a_mean_per_metric(self):
        table = rows({"a": [Figure("error", 2.0, 4.0, 1.0)], "b": [Figure("error", 4.0, 8.0, 2.0)]})
        assert table.columns.tolist() == list(COLUMNS)
        assert table["dataset"].tolist() == ["a", "b", MEAN]
        mean = table.iloc[-1]
        assert (mean["ours"], mean["peer"], mean["cpu_s"]) == (3.0, 6.0, 3.0)
        assert (mean["goal"], mean["published"]) == ("<4", 5.0)
        assert table["goal"].tolist()[:2] == ["<6", "<6"]

    def test_a_peer_that_lacks_a_data_set_has_no_mean(self):
        table = rows({"a": [Figure("error", 2.0)], "b": [Figure("error", 4.0, 8.0)]})
        assert pd.isna(table.iloc[-1]["peer"]) and table.iloc[-1]["peer_name"] == ""

    def test_missing_data_are_said(self):
        table = rows({"a": [Figure("error", 2.0)]})
        missing = table[table["metric"] == "missing"]
        assert missing["dataset"].tolist() == ["b"]
        assert table[table["dataset"] == MEAN]["ours"].tolist() == [2.0]

    @pytest.mark.parametrize(
        ("value", "goal", "expected"),
        [(3.9, "<4", True), (4.0, "<4", False), (86, ">85", True), (1, "", None)],
    )
    def test_goals(self, value, goal, expected):
        assert holds(value, goal) is expected
        assert holds(math.nan, ">1") is None

    def test_files_and_what_is_missing(self, tmp_path):
        (tmp_path / "b.txt").touch()
        files, missing = AREA.files("b", tmp_path)
        assert [path.name for path in files] == ["b.txt"] and missing == ["c/*.txt"]


def test_every_goal_of_the_catalogue_is_a_number_behind_a_sign():
    for area in AREAS.values():
        for metric in area.metrics.values():
            for goal in (metric.goal, metric.each):
                assert not goal or (goal[0] in "<>" and float(goal[1:]) > 0)


def test_the_page_shows_ours_the_peer_and_what_is_missing():
    one = next(iter(AREAS.items()))
    name, area = one
    first, second = list(area.datasets)[:2]
    metric = next(iter(area.metrics))
    figures = {first: [Figure(metric, 3.5, 4.5, 0.1)], second: [Figure(metric, 7.0, 6.0, 0.1)]}
    table = truth_rows(name, area, figures)
    html = render_truth(table, read_assets(ASSETS), "1.0")
    assert "3.5" in html and area.peer in html and "chip warn" in html
    assert "missing" in html and list(area.datasets)[2] in html
    assert "http" not in html.replace("http-equiv", "")


class TestScores:
    def test_kappa_is_agreement_beyond_chance(self, rng):
        truth = rng.random(20_000) < 0.3
        assert kappa(truth, truth) == 1.0
        assert abs(kappa(rng.random(20_000) < 0.3, truth)) < 0.03
        assert kappa(np.ones(5, bool), np.ones(5, bool)) == 1.0

    def test_f1(self):
        found, truth = np.array([1, 1, 0, 0], bool), np.array([1, 0, 1, 0], bool)
        assert f1(found, truth) == 0.5
        assert f1(np.zeros(3, bool), np.zeros(3, bool)) == 1.0

    def test_the_peer_takes_a_house_away_and_keeps_a_slope(self, rng):
        x, y = rng.uniform(0, 60, (2, 20_000))
        house = (np.abs(x - 30) < 6) & (np.abs(y - 30) < 5)
        z = 0.1 * x + np.where(house, 5.0, 0.0) + rng.normal(0, 0.03, len(x))
        found = smrf(np.column_stack([x, y, z]))
        assert found[~house].mean() > 0.99 and not found[house].any()
