from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from roadsight.evidence.effects_audit import (
    COLUMNS,
    PoleAnswer,
    answer_change,
    bearing_change,
    matches,
    pole_change,
    rating_change,
)
from roadsight.evidence.variants import JobRecord
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import write_table
from roadsight.stages.evidence import audit_pole_effects
from tests.conftest import PROJECT

POLES = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [30.0, 0.0]])


def test_poles_that_appear_vanish_or_move():
    assert pole_change(POLES, POLES) == 0.0
    assert pole_change(POLES, POLES[::-1] + 0.3) == 0.0
    assert pole_change(POLES, POLES[:3]) == pole_change(POLES[:3], POLES) == 0.25
    assert pole_change(POLES, np.add(POLES, [[0, 0], [0, 0], [0, 0.6], [0, 0]])) == 0.25
    assert pole_change(POLES, POLES[:0]) == 1.0
    assert pole_change(POLES[:0], POLES[:0]) == 0.0


def test_each_pole_is_matched_once_and_as_many_as_can_be():
    one, other = np.array([[0.0, 0.0], [0.45, 0.0]]), np.array([[0.4, 0.0], [0.8, 0.0]])
    assert sorted(map(tuple, matches(one, other).tolist())) == [(0, 0), (1, 1)]


def sightings(turn=0.0, kept=True):
    return pd.DataFrame(
        {
            "image": ["a", "a", "b", "c"],
            "view": "front",
            "u_foot": [1.0, 2.0, 1.0, 5.0],
            "v_foot": 3.0,
            "bearing_deg": (np.array([359.9, 10.0, 0.05, 90.0]) + turn) % 360,
            "sigma_bearing_deg": [0.1, 0.5, 0.1, 0.1],
            "kept": kept,
        }
    )


def test_bearings_beyond_their_sigma():
    assert bearing_change(sightings(), sightings()) == 0.0
    assert bearing_change(sightings(), sightings(0.2)) == 0.75
    assert bearing_change(sightings(), sightings(0.05)) == 0.0
    assert bearing_change(sightings(), sightings(0.2, kept=False)) == 0.0


def hazard(*ratings):
    return pd.DataFrame(POLES[: len(ratings)], columns=["x", "y"]).assign(rating=list(ratings))


def test_ratings_of_the_same_poles():
    one = hazard("high", "low", "low", "low")
    assert rating_change(one, one) == 0.0
    assert rating_change(one, hazard("high", "low", "medium", "low")) == 0.25
    assert rating_change(one, hazard()) == 0.0


def test_the_largest_change_counts():
    poles = pd.DataFrame(POLES, columns=["x", "y"]).assign(kept=[True, True, True, False])
    one = PoleAnswer(poles, sightings(), hazard("low", "low"))
    assert answer_change(one, one) == 0.0
    fewer = PoleAnswer(poles.iloc[:2], sightings(), hazard("low", "low"))
    assert answer_change(one, fewer) == pytest.approx(1 / 3)
    turned = PoleAnswer(poles, sightings(0.2), hazard("low", "low"))
    assert answer_change(one, turned) == 0.75


class FakeVariant:
    """Finished results of a site in which skipping side views loses a pole."""

    changes: ClassVar[list[dict]] = []

    def __init__(self, folder, changes):
        self.folder = folder
        self.skipped = changes.get("effects", {}).get("side_views") == "skip"

    @classmethod
    def prepare(cls, base, folder, config, site, changes):
        cls.changes.append(changes)
        made = cls(Path(folder), changes)
        (made.folder / "poles/sightings").mkdir(parents=True)
        poles = pd.DataFrame(POLES, columns=["x", "y"]).assign(kept=True)
        kept = poles.iloc[: 3 if made.skipped else 4]
        write_table(made.result("poles/poles.parquet"), kept)
        write_table(made.result("poles/sightings/0.parquet"), sightings())
        write_table(made.result("poles/hazard.parquet"), kept.assign(rating="low"))
        return made

    def result(self, name):
        return self.folder / name

    def run(self, targets):
        return {"measure_poles": 1}

    def records(self, targets):
        cpu_s = 10.0 if self.skipped else 16.0
        return [JobRecord("measure_poles", "l", True, cpu_s, 20.0, 100.0)]


def test_rows_of_the_audit(tmp_path, monkeypatch):
    monkeypatch.setattr(audit_pole_effects, "Variant", FakeVariant)
    catalogue = PROJECT / "config/effects.yaml"
    names = {"rain": "placement", "side_views": "poles", "scale_factor": "poles"}
    decisions = [
        {
            **{"effect": name, "job": job, "quantity": "q", "value": 1.0, "unit": ""},
            **{"threshold": 0.5, "expected_change": 0.1, "expected_seconds": 1.0, "reason": "r"},
            "decision": "skip" if name == "scale_factor" else "simulate",
        }
        for name, job in [*names.items(), ("road_alignment", "poles")]
    ]
    write_json(tmp_path / "effects.json", decisions)
    options = ["--site", "s", "--effects", tmp_path / "effects.json", "--catalogue", catalogue]
    options += ["--config", "{}", "--work", tmp_path / "work", "--out", tmp_path / "rows.json"]
    options += ["--leave-out", "road_alignment"]
    assert audit_pole_effects.main([str(option) for option in options]) == 0
    sides, scale = read_json(tmp_path / "rows.json")
    assert set(sides) == set(COLUMNS)
    assert (sides["effect"], sides["found_with"], sides["found_without"]) == ("side_views", 4, 3)
    assert (sides["change"], sides["right"], sides["cpu_seconds"]) == (0.25, True, 6.0)
    assert (scale["effect"], scale["change"], scale["right"]) == ("scale_factor", 0.0, True)
    assert FakeVariant.changes[1:] == [
        {"effects": {"side_views": "skip"}},
        {"effects": {"scale_factor": "simulate"}},
    ]
    assert not (tmp_path / "work").exists()
