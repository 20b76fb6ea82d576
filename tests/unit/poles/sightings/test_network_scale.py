import numpy as np
import pandas as pd
import pytest

from roadsight.poles.sightings.metric_depth import COLUMNS, network_scales, with_scales


def sightings(rng, ratio, count=60, scatter=0.15, view="front", route="a"):
    """Objects at 10 to 50 m whose network distances are off by a ratio."""
    true_m = rng.uniform(10, 50, count)
    network_m = true_m * ratio * np.exp(rng.normal(0, scatter, count))
    ground_m = true_m * np.exp(rng.normal(0, 0.03, count))
    table = pd.DataFrame(
        {
            "route": route, "view": view, "true_m": true_m, "depth_network_m": network_m,
            "sigma_depth_network_m": 0.05 * network_m, "depth_ground_m": ground_m,
            "sigma_depth_ground_m": 0.03 * ground_m, "depth_lidar_m": np.nan,
            "sigma_depth_lidar_m": np.nan,
        }
    )  # fmt: skip
    unseen = np.arange(count) % 3 == 0
    table.loc[unseen, ["depth_ground_m", "sigma_depth_ground_m"]] = np.nan
    table["depth_m"], table["sigma_depth_m"] = network_m, 0.05 * network_m
    return table.assign(depth_from="network")


@pytest.mark.parametrize("ratio", [0.6, 1.3])
def test_a_network_that_is_off_in_one_camera_is_set_right_there(rng, ratio):
    off, fine = sightings(rng, ratio), sightings(rng, 1.0, view="left")
    table = pd.concat([off, fine], ignore_index=True)
    (scale,) = network_scales(table)
    assert (scale.route, scale.view, scale.pairs) == ("a", "front", 40)
    assert scale.ratio == pytest.approx(ratio, rel=0.1)
    assert scale.sigma == pytest.approx(0.15, abs=0.06)
    mended = with_scales(table, [scale])
    pd.testing.assert_frame_equal(mended[mended["view"] == "left"], table[table["view"] == "left"])
    front = mended[mended["view"] == "front"]
    error = front["depth_m"] / front["true_m"] - 1
    assert np.abs(error).median() < 0.06
    within = np.abs(front["depth_m"] - front["true_m"]) < 2 * front["sigma_depth_m"]
    assert within.mean() > 0.85
    assert set(front.loc[front["depth_ground_m"].isna(), "depth_from"]) == {"network"}
    assert (front["depth_from"] == "network+ground").any()


def test_scatter_alone_is_no_scale(rng):
    """Three standard errors: one camera in some hundred is touched without need."""
    touched = [bool(network_scales(sightings(rng, 1.0))) for _ in range(100)]
    assert sum(touched) <= 4


def test_few_feet_tell_nothing(rng):
    few = sightings(rng, 0.5, count=15)
    assert network_scales(few) == []
    assert with_scales(few, []) is few
    none = few.assign(**dict.fromkeys(COLUMNS, np.nan))
    assert network_scales(none) == []
