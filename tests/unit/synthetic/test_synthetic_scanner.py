from dataclasses import replace

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight_worlds.casting.alignment import to_plan, to_road
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.casting.terrain import height_at
from roadsight_worlds.highway.airborne_survey import survey
from roadsight_worlds.highway.highway import build_highway
from roadsight_worlds.highway.mobile_scanner import MobileScanner, pulses, scan, sweeps_of
from roadsight_worlds.highway.returns import LaserModel, measure

POINTS = 150_000


@pytest.fixture(scope="module")
def site():
    return build_highway(seed=1, length_m=60.0)


def gather(chunks):
    chunks = list(chunks)
    names = ("xyz_m", "intensity", "time_s", "truth_class", "sweep")
    return {name: np.concatenate([getattr(c, name) for c in chunks]) for name in names}


@pytest.fixture(scope="module")
def cloud(site):
    return gather(scan(site, POINTS, np.random.default_rng(1)))


def test_the_number_of_points_is_about_right(cloud):
    assert len(cloud["xyz_m"]) == pytest.approx(POINTS, rel=0.03)


def test_road_points_lie_on_the_road_within_the_noise(site, cloud):
    road = cloud["xyz_m"][cloud["truth_class"] == TruthClass.ROAD]
    assert len(road) > 0.5 * POINTS
    residual = road[:, 2] - height_at(site.terrain, road[:, :2])
    residual = residual[np.isfinite(residual)]
    assert 0.003 < residual.std() < 0.012
    assert np.abs(residual).max() < 0.06
    classes = site.ground_classes(road[:, :2])
    assert (classes == TruthClass.ROAD).mean() > 0.998


def test_every_kind_of_surface_is_scanned(cloud):
    found = set(np.unique(cloud["truth_class"]))
    assert found == {int(c) for c in TruthClass}


def test_range_noise_has_its_sigma(site):
    laser = LaserModel(mixed_edge_share=0.0, multipath_share=0.0, clutter_share=0.0)
    rng = np.random.default_rng(2)
    origins, directions = downward_rays(site, rng, 40_000)
    exact = site.scene.cast(origins, directions, 100.0)[0]
    echoes = measure(site, origins, directions, laser, rng)
    error = echoes.range_m - exact[echoes.pulse]
    for truth, sigma in ((TruthClass.ROAD, 0.005), (TruthClass.GROUND, np.hypot(0.005, 0.02))):
        chosen = error[echoes.truth_class == truth]
        if truth == TruthClass.GROUND:  # the median strip is soil, the verges are grass
            plan = origins[echoes.pulse] + exact[echoes.pulse, None] * directions[echoes.pulse]
            offset = np.abs(to_road(site.alignment, plan[:, :2])[:, 1])
            chosen = error[(echoes.truth_class == truth) & (offset > 12.0)]
        assert chosen.std() == pytest.approx(sigma, rel=0.05)
        assert abs(chosen.mean()) < 4 * sigma / np.sqrt(len(chosen))


def downward_rays(site, rng, n):
    road = np.column_stack([rng.uniform(2, 40, n), rng.uniform(-15, 15, n)])
    xy = to_plan(site.alignment, road)
    origins = np.column_stack([xy, height_at(site.terrain, xy) + 4.0])
    slant = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), -np.ones(n)])
    return origins, slant / np.linalg.norm(slant, axis=1, keepdims=True)


def test_false_points_come_in_their_shares(site):
    rng = np.random.default_rng(3)
    origins, directions = downward_rays(site, rng, 60_000)
    laser = LaserModel(mixed_edge_share=0.0, multipath_share=0.01, clutter_share=0.02)
    echoes = measure(site, origins, directions, laser, rng)
    exact = site.scene.cast(origins, directions, 100.0)[0][echoes.pulse]
    late, air = (echoes.truth_class == c for c in (TruthClass.LOW_NOISE, TruthClass.HIGH_NOISE))
    assert late.mean() == pytest.approx(0.01, rel=0.2)
    assert air.mean() == pytest.approx(0.02, rel=0.2)
    assert np.all(echoes.range_m[late] > exact[late] + 0.2)
    assert np.all(echoes.range_m[air] < exact[air])
    assert np.array_equal(echoes.pulse, np.unique(echoes.pulse))  # one return a pulse


def test_mixed_edges_lie_between_two_surfaces(site):
    sweep = sweeps_of(site, MobileScanner())[0]
    elapsed = np.linspace(0.5, 3.0, 60_000)
    rays = pulses(site, MobileScanner(), sweep, elapsed, 2 * np.pi * 50.0 * elapsed)
    quiet = LaserModel(multipath_share=0.0, clutter_share=0.0, range_sigma_m=0.0)
    exact, ids, _ = site.scene.cast(*rays, 100.0)
    echoes = measure(site, *rays, replace(quiet, mixed_edge_share=1.0), np.random.default_rng(4))
    mixed = echoes.pulse[echoes.truth_class == TruthClass.LOW_NOISE]
    assert len(mixed) > 50
    low = np.minimum(exact[mixed], exact[mixed - 1])
    high = np.maximum(exact[mixed], exact[mixed - 1])
    measured = echoes.range_m[echoes.truth_class == TruthClass.LOW_NOISE]
    assert np.all((measured > low) & (measured < high))
    assert np.all(ids[mixed] != ids[mixed - 1])
    none = measure(site, *rays, replace(quiet, mixed_edge_share=0.0), np.random.default_rng(4))
    assert not np.any(none.truth_class == TruthClass.LOW_NOISE)


def test_intensity_tells_materials_apart_and_fades(site):
    rng = np.random.default_rng(5)
    origins, directions = downward_rays(site, rng, 40_000)
    echoes = measure(site, origins, directions, LaserModel(), rng)
    road = echoes.truth_class == TruthClass.ROAD
    grass = echoes.truth_class == TruthClass.GROUND
    assert np.median(echoes.intensity[road]) < 0.5 * np.median(echoes.intensity[grass])
    assert echoes.intensity[road].max() > 4 * np.median(echoes.intensity[road])  # lane markings
    keeps = LaserModel(weakest_signal_per_m2=0.0)
    up_there = measure(site, origins + np.array([0.0, 0.0, 26.0]), directions, keeps, rng)
    faded = up_there.intensity[up_there.truth_class == TruthClass.ROAD]
    assert np.median(faded) < 0.7 * np.median(echoes.intensity[road])


def test_dark_and_far_surfaces_are_lost_first(site):
    rng = np.random.default_rng(6)
    origins, directions = downward_rays(site, rng, 20_000)
    deaf = LaserModel(weakest_signal_per_m2=0.02)
    heard = measure(site, origins, directions, deaf, rng).truth_class
    all_of_them = measure(site, origins, directions, LaserModel(), rng).truth_class
    share = [(heard == c).sum() / (all_of_them == c).sum() for c in (11, 2)]
    assert share[0] < 0.2 * share[1]


def test_profiles_are_planes_that_turn_with_the_vehicle(site):
    scanner = MobileScanner()
    angle = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    for sweep in sweeps_of(site, scanner):
        origins, directions = pulses(site, scanner, sweep, np.full(360, 2.0), angle)
        assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
        normal = np.cross(directions[0], directions[90])
        assert np.abs(directions @ normal).max() < 1e-12
        station, offset = to_road(site.alignment, origins[:1, :2])[0]
        assert station == pytest.approx(24.0 if sweep.forward else 36.0)
        assert offset == pytest.approx(-7.375 if sweep.forward else 7.375)
        above = origins[0, 2] - height_at(site.terrain, origins[:1, :2])[0]
        assert above == pytest.approx(scanner.head_height_m, abs=0.02)
        across = np.array([-np.sin(0.4), np.cos(0.4)])  # about square to the road
        turned = np.degrees(np.arccos(abs(directions[0, :2] @ across)))
        assert turned == pytest.approx(45.0, abs=8.0)


def test_nothing_is_scanned_behind_the_car(site, cloud):
    """The parked car's far side is in its own shadow for the lane that is scanned from."""
    station = 0.26 * site.tunnel_start_m
    station_m, offset_m = to_road(site.alignment, cloud["xyz_m"][:, :2]).T
    ground = np.isin(cloud["truth_class"], (TruthClass.ROAD, TruthClass.GROUND))
    here = ground & (np.abs(station_m - station) < 0.5)
    behind = here & (offset_m < -11.45) & (offset_m > -11.7)
    beside = here & (offset_m < -8.7) & (offset_m > -8.95)
    assert beside.sum() > 20
    assert behind.sum() < 0.2 * beside.sum()


def test_the_cloud_is_in_the_order_of_time(cloud):
    for sweep in np.unique(cloud["sweep"]):
        assert np.all(np.diff(cloud["time_s"][cloud["sweep"] == sweep]) > 0)
    assert np.all(np.diff(cloud["sweep"].astype(int)) >= 0)
    assert set(cloud["sweep"]) == {1, 2, 3, 4}


def test_the_same_seed_gives_the_same_cloud(site):
    first, again, other = (
        gather(scan(site, 20_000, np.random.default_rng(seed))) for seed in (7, 7, 8)
    )
    for name, values in first.items():
        np.testing.assert_array_equal(values, again[name])
    assert not np.array_equal(first["intensity"], other["intensity"])


def test_too_few_points_are_refused(site):
    with pytest.raises(InputError, match="points"):
        list(scan(site, 999, np.random.default_rng(1)))


def test_pulses_into_the_sky_bring_nothing(site):
    up = np.tile([0.0, 0.0, 1.0], (50, 1))
    origins = np.tile([0.0, 0.0, 500.0], (50, 1))
    echoes = measure(site, origins, up, LaserModel(clutter_share=0.0), np.random.default_rng(1))
    assert len(echoes.pulse) == 0
    assert len(echoes.range_m) == len(echoes.intensity) == len(echoes.truth_class) == 0


@pytest.fixture(scope="module")
def aerial(site):
    return gather(survey(site, POINTS, np.random.default_rng(1)))


class TestFromTheAir:
    """The same site surveyed by an aircraft."""

    def test_the_density_is_even_and_heights_lie_within_the_noise(self, site, aerial):
        open_road = aerial["truth_class"] == TruthClass.ROAD
        station, offset = to_road(site.alignment, aerial["xyz_m"][:, :2]).T
        for low, high in ((2.0, 6.0), (6.0, 10.0)):
            for side in (-1.0, 1.0):
                strip = open_road & (side * offset > low) & (side * offset < high)
                strip &= (station > 25.0) & (station < 40.0)
                assert strip.sum() / (4.0 * 15.0) == pytest.approx(POINTS / (90 * 60), rel=0.15)
        road = aerial["xyz_m"][open_road]
        residual = road[:, 2] - height_at(site.terrain, road[:, :2])
        assert np.std(residual) == pytest.approx(0.02, abs=0.005)
        assert abs(np.median(residual)) < 0.002

    def test_the_sides_of_walls_have_few_points(self, site, aerial, cloud):
        def on_the_sides(points):
            """Share of the barrier's points between its foot and its top."""
            barrier = points["xyz_m"][points["truth_class"] == TruthClass.BARRIER]
            barrier = barrier[np.abs(to_road(site.alignment, barrier[:, :2])[:, 1]) < 0.5]
            above_m = barrier[:, 2] - height_at(site.terrain, barrier[:, :2])
            return np.mean((above_m > 0.35) & (above_m < 0.8))

        assert on_the_sides(aerial) < 0.15 < 0.3 < on_the_sides(cloud)

    def test_each_pulse_has_a_time_and_the_seed_decides(self, site, aerial):
        assert len(np.unique(aerial["time_s"])) == len(aerial["time_s"])
        again = gather(survey(site, POINTS, np.random.default_rng(1)))
        assert all(np.array_equal(aerial[name], again[name]) for name in aerial)
