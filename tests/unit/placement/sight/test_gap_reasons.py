import numpy as np
import pandas as pd

from roadsight.placement.sight.lanes import free_shares, rasterise_lanes
from roadsight.placement.sight.passing import TRUCK
from roadsight.stages.placement.find_obstacles import (
    DARK,
    VEHICLES,
    WEATHER,
    hidden_too_often,
    refine_reasons,
)
from tests.unit.placement.sight.test_lanes import straight_lanes


def test_reasons_say_what_effects_took():
    gaps = pd.DataFrame(
        {
            "reason": ["out of range", "too few beams", "hidden", "too few beams", "hidden"],
            "nearest_m": [250.0, 130.0, 90.0, 40.0, 40.0],
        }
    )
    often = np.array([True, True, True, True, True])
    found = refine_reasons(gaps, 120.0, 80.0, often).tolist()
    assert found == ["out of range", WEATHER, DARK, VEHICLES, "hidden"]
    assert refine_reasons(gaps, np.inf, np.inf, None).tolist() == gaps["reason"].tolist()


def test_vehicles_are_blamed_where_every_near_candidate_loses_the_target():
    traffic = rasterise_lanes(straight_lanes(2.0), np.array([[0.03]]), (TRUCK,))
    candidates = pd.DataFrame({"x": [0.0, 10.0, 20.0], "y": -2.0, "z": 5.0})
    targets = pd.DataFrame({"x": [10.0, 10.0], "y": [9.0, -1.0], "z": 0.0})
    middles = targets[["x", "y", "z"]].to_numpy() + np.array([0, 0, 0.3])
    shares = [free_shares(traffic, place, middles) for place in candidates.to_numpy()]
    best = np.max(shares, axis=0)
    assert best[0] < 0.7 < best[1]
    np.testing.assert_array_equal(
        hidden_too_often(targets, candidates, traffic, 0.7, 0.6), [True, False]
    )
