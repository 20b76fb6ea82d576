import numpy as np
import pytest

from roadsight.placement.sight.kinds import Box
from roadsight.placement.sight.passing import CAR, TRUCK, expected_in_the_way, vehicles_per_m


def drawn(sensor, target, lane_y, per_m, vehicle, rng, draws=4000):
    """Mean number of boxes that the line meets, by the slab method on every box of every draw."""
    start, direction = np.array(sensor), np.array(target) - np.array(sensor)
    reach = 400.0
    low = np.array([0, lane_y - vehicle.width_m / 2, 0.0])
    high = np.array([0, lane_y + vehicle.width_m / 2, vehicle.height_m])
    met = 0
    for _ in range(draws):
        middle = rng.uniform(-reach, reach, rng.poisson(per_m * 2 * reach))
        lows = np.tile(low, (len(middle), 1))
        highs = np.tile(high, (len(middle), 1))
        lows[:, 0], highs[:, 0] = middle - vehicle.length_m / 2, middle + vehicle.length_m / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (lows - start) / direction, (highs - start) / direction
        enter = np.minimum(one, two).max(axis=1, initial=0.0)
        leave = np.maximum(one, two).min(axis=1, initial=1.0)
        met += int((enter < leave).sum())
    return met / draws


@pytest.mark.parametrize(
    ("sensor", "target", "vehicle"),
    [
        ((0, 0, 6.0), (40, 6, 0.3), CAR),
        ((0, 0, 6.0), (40, 9, 0.3), TRUCK),
        ((0, 0, 4.0), (-90, 12, 0.1), TRUCK),
        ((0, 0, 2.0), (15, 9, 2.0), TRUCK),
    ],
)
def test_expected_vehicles_equal_drawn_ones(sensor, target, vehicle):
    expected = expected_in_the_way(sensor, target, 5.0, 0.02, vehicle)
    mean = drawn(sensor, target, 5.0, 0.02, vehicle, np.random.default_rng(0))
    assert mean == pytest.approx(expected, abs=4 * np.sqrt(expected / 4000))
    assert expected > 0.05


def test_nothing_is_in_the_way_of_a_line_above_or_short_of_the_lane():
    assert expected_in_the_way((0, 0, 6), (20, 9, 5.0), 5.0, 0.02, TRUCK) == 0
    assert expected_in_the_way((0, 0, 6), (20, 3, 0.3), 5.0, 0.02, TRUCK) == 0


def test_straight_across_only_the_length_counts():
    box = Box(10.0, 2.0, 4.0)
    assert expected_in_the_way((0, 0, 2), (0, 9, 0), 5.0, 0.01, box) == pytest.approx(0.1)


def test_density_is_flow_over_speed():
    cars, trucks = vehicles_per_m(48_000, 0.25, 100, 0.1, 4)
    assert cars + trucks == pytest.approx(1200 / 100_000)
    assert trucks / cars == pytest.approx(1 / 3)
