import numpy as np
import pytest
from scipy import sparse

from roadsight.placement.plans import availability
from roadsight.placement.plans.availability import (
    AtLevel,
    CommonTraffic,
    at_level,
    contains,
    counted_shares,
    joint_share,
    past_traffic,
    shares_alone,
    spans_in_the_way,
)
from roadsight.placement.sight.lanes import free_shares, rasterise_lanes
from roadsight.placement.sight.passing import CAR, TRUCK
from roadsight.setcover.plans.joint import solve_joint
from tests.unit.placement.sight.test_lanes import straight_lanes

LANES_Y = (1.75, 5.25, 8.75)
PER_M = np.array([[0.012, 0.004], [0.02, 0.006], [0.015, 0.002]])
SENSORS = {
    "near": (0.0, -2.0, 5.0), "beside": (6.0, -2.0, 6.0), "far": (60.0, -2.0, 6.0),
    "opposite": (-20.0, 13.0, 5.0), "high": (0.0, -2.0, 9.0),
}  # fmt: skip
TARGETS = np.array([[20.0, 8.75, 0.3], [5.0, 5.25, 0.3], [-40.0, 8.0, 0.3], [10.0, 11.0, 0.3]])


@pytest.fixture(scope="module")
def traffic():
    return rasterise_lanes(straight_lanes(*LANES_Y), PER_M, (CAR, TRUCK))


def drawn(sensors, target, rng, draws=20_000):
    """Share of draws in which at least one sensor sees a target: boxes on lanes, rays through them.

    Vehicles are drawn lane by lane and class by class; those that stand on the target are left out.
    """
    reach = 190.0
    seen = 0
    for _ in range(draws):
        low, high = [], []
        for lane, y in enumerate(LANES_Y):
            for kind, box in enumerate((CAR, TRUCK)):
                middle = rng.uniform(-reach, reach, rng.poisson(PER_M[lane, kind] * 2 * reach))
                on_target = (abs(middle - target[0]) < box.length_m / 2) & (
                    abs(y - target[1]) < box.width_m / 2
                )
                middle = middle[~on_target]
                size = np.array([box.length_m / 2, box.width_m / 2, 0.0])
                foot = np.column_stack([middle, np.full(len(middle), y), np.zeros(len(middle))])
                low.append(foot - size)
                high.append(foot + size + [0, 0, box.height_m])
        lows, highs = np.concatenate(low), np.concatenate(high)
        for sensor in sensors:
            start, way = np.array(sensor), target - np.array(sensor)
            with np.errstate(divide="ignore", invalid="ignore"):
                one, two = (lows - start) / way, (highs - start) / way
            enter = np.minimum(one, two).max(axis=1, initial=0.0)
            leave = np.maximum(one, two).min(axis=1, initial=1.0)
            if not (enter < leave).any():
                seen += 1
                break
    return seen / draws


def closed(traffic, sensors, target):
    return joint_share(
        [spans_in_the_way(traffic, np.array(s), target[None])[0] for s in sensors], PER_M
    )


@pytest.mark.parametrize("target", range(len(TARGETS)))
@pytest.mark.parametrize(
    "names", [("near",), ("near", "beside"), ("near", "beside", "far", "opposite")]
)
def test_the_closed_form_is_that_of_drawn_traffic(traffic, target, names):
    sensors, draws = [SENSORS[name] for name in names], 3000
    rng = np.random.default_rng(target)
    share = closed(traffic, sensors, TARGETS[target])
    error = 4 * np.sqrt(max(share * (1 - share), 1e-3) / draws)
    # The raster of lanes knows a vehicle's side to a quarter of a metre.
    assert drawn(sensors, TARGETS[target], rng, draws) == pytest.approx(share, abs=error + 0.01)


def test_of_one_sensor_it_is_the_free_share(traffic):
    for sensor in SENSORS.values():
        free = free_shares(traffic, np.array(sensor), TARGETS)
        alone = [closed(traffic, [sensor], target) for target in TARGETS]
        np.testing.assert_allclose(alone, free, rtol=1e-9)
        found = shares_alone(traffic, np.array(sensor), TARGETS)
        np.testing.assert_allclose(found, free, rtol=1e-9)


def test_never_more_than_independent_sensors_and_never_less_than_the_best(traffic):
    rng = np.random.default_rng(3)
    for _ in range(60):
        count = rng.integers(2, 7)
        sensors = rng.uniform((-80, -6, 3), (80, -2, 9), (count, 3))
        target = rng.uniform((-40, 0, 0.2), (40, 12, 0.6))
        single = np.array([closed(traffic, [s], target) for s in sensors])
        together = closed(traffic, list(sensors), target)
        assert together <= 1 - np.prod(1 - single) + 1e-9
        assert together >= single.max() - 1e-9


def test_a_sensor_twice_sees_no_more(traffic):
    one = closed(traffic, [SENSORS["near"]], TARGETS[0])
    assert closed(traffic, [SENSORS["near"]] * 3, TARGETS[0]) == pytest.approx(one)
    assert joint_share([], PER_M) == 0.0
    assert joint_share([np.empty((0, 4))], PER_M) == 1.0


def test_spans_within_spans():
    inner = np.array([[0, 1, 2.0, 3.0], [1, 0, 5.0, 6.0]])
    outer = np.array([[0, 1, 1.0, 3.5], [1, 0, 5.0, 7.0], [2, 0, 0.0, 1.0]])
    assert contains(outer, inner)
    assert not contains(inner, outer)
    assert contains(inner, np.empty((0, 4)))


class TestPlans:
    """A row of poles beside the road, and what a level costs."""

    @pytest.fixture(scope="class")
    def road(self, traffic):
        places = [(x, -2.0, z) for x in range(-60, 61, 15) for z in (5.0, 8.0)]
        sensors = np.array(places, float)
        points = np.array([[x, y, 0.3] for x in range(-50, 51, 10) for y in (1.0, 6.0, 11.0)])
        shares = np.array([free_shares(traffic, s, points) for s in sensors])
        far = np.linalg.norm(sensors[:, None] - points[None], axis=2) > 70
        return sensors, points, sparse.csr_matrix(np.where(far, 0.0, shares))

    def solve(self, traffic, road, level, common):
        sensors, points, shares = road
        posed = at_level(shares, np.ones(len(sensors)), np.arange(len(sensors)) // 2, level)
        oracle = CommonTraffic(traffic, sensors, points, shares, level, posed.below)
        return posed, oracle, solve_joint(posed.problem, 20, oracle=oracle if common else None)

    def test_common_traffic_costs_sensors_and_never_saves_any(self, traffic, road):
        costs = []
        for level in (0.5, 0.8, 0.9):
            _, oracle, free = self.solve(traffic, road, level, common=False)
            _, oracle, strict = self.solve(traffic, road, level, common=True)
            asked = np.setdiff1d(np.arange(len(road[1])), sorted(oracle.given_up))
            assert strict.status == free.status == "optimal"
            assert strict.objective >= free.objective
            assert (oracle.joint_shares(strict.chosen)[asked] >= level - 1e-6).all()
            costs.append(strict.objective)
        assert costs == sorted(costs)

    def test_a_level_out_of_reach_is_told(self, traffic, road):
        posed, _, cover = self.solve(traffic, road, 1 - 1e-12, common=False)
        assert len(posed.below) > 0
        assert isinstance(posed, AtLevel)
        seen = road[2][cover.chosen].getnnz(axis=0)
        assert (seen[posed.below] >= 1).all()


def test_choices_at_one_place_look_past_the_same_vehicles(traffic, monkeypatch):
    """Poses and kinds at one place: lines are walked once, and each row is told the same."""
    rng = np.random.default_rng(8)
    places = rng.uniform((-60, -6, 3), (60, -2, 9), (5, 3))
    sensors = places[[0, 1, 0, 2, 0, 3, 4, 3]]
    points = rng.uniform((-40, 0, 0.2), (40, 12, 0.6), (30, 3))
    seen = sparse.csr_matrix(rng.random((8, 30)) < 0.6)
    walked = []

    def counted(*arguments):
        walked.append(len(arguments[2]))
        return shares_alone(*arguments)

    monkeypatch.setattr(availability, "shares_alone", counted)
    found = past_traffic(seen, traffic, sensors, points)
    assert len(walked) == len(places)
    for row in range(8):
        columns = seen[row].indices
        expected = shares_alone(traffic, sensors[row], points[columns])
        np.testing.assert_array_equal(found[row].data, expected)
    oracle = CommonTraffic(traffic, sensors, points, found, 0.9, np.zeros(0, np.int64))
    twice = oracle.joint_shares(np.array([0, 2, 4]))
    union = np.flatnonzero(np.asarray(seen[[0, 2, 4]].sum(axis=0)).ravel())
    # Three poses at one place are one line of sight.
    np.testing.assert_allclose(
        twice[union], shares_alone(traffic, places[0], points[union]), rtol=1e-9
    )


def test_classes_count_every_target():
    counted = counted_shares(np.array([0.0, 0.5, 0.95, 0.9999, 1.0]))
    assert sum(counted["targets"]) == 5
    assert counted["targets"][-1] == 2
