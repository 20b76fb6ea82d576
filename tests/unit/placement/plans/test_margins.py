import numpy as np
import pytest

from roadsight.placement.plans.handover import dark_range_m, distances_m, margins, ranges_m
from roadsight.placement.sensors.sensors import Radar, Sensor

SENSOR = Sensor(elevations_deg=(0, 1), range_m=120, range_10_m=40)


def test_dark_targets_are_seen_from_the_range_on_the_sheet():
    assert dark_range_m(SENSOR, 120) == 40
    # Already less: rain.
    assert dark_range_m(SENSOR, 30) == 30
    # The square root law where the sheet says nothing.
    law = Sensor(elevations_deg=(0, 1), range_m=100)
    assert dark_range_m(law, 100) == pytest.approx(100 * np.sqrt(0.1 / 0.8))


def test_radars_mind_no_darkness():
    zone = {"half_angle_deg": 9, "range_m": 90, "resolution_deg": 1}
    assert dark_range_m(Radar(kind="radar", zones=[zone]), 90) == 90


def test_targets_beyond_the_shorter_range_are_lost():
    feet = np.array([[10.0, 0, 0], [50.0, 0, 0], [100.0, 0, 0], [300.0, 0, 0]])
    places = np.array([[0.0, 0, 0.3], [90.0, 0, 0.3]])
    seen = np.array([[1, 1, 1, 0], [0, 0, 0, 0]], bool)
    reach, dark = ranges_m([SENSOR, SENSOR], [120, 120])
    found, if_dark, if_shorter = margins(seen, distances_m(places, feet, 0.6), reach, dark)
    assert found["dark"]["lost"] == 2
    assert found["dark"]["share"] == pytest.approx(2 / 3)
    assert if_dark.tolist() == [True, False, False, False]
    # Two thirds of 120 m are 80 m: the target at 100 m is lost unless the second sensor sees it.
    assert found["shorter"]["lost"] == 1
    assert if_shorter.tolist() == [True, True, False, False]
    seen[1, 2] = True
    assert margins(seen, distances_m(places, feet, 0.6), reach, dark)[0]["shorter"]["lost"] == 0


def test_a_plan_without_sensors_loses_nothing():
    none = np.zeros((0, 3))
    found, *_ = margins(np.zeros((0, 3), bool), none, np.zeros(0), np.zeros(0))
    assert found["dark"]["lost"] == found["shorter"]["lost"] == 0
