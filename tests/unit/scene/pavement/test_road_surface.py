import numpy as np
import pytest
import shapely

from roadsight.base.errors import InputError
from roadsight.evidence.labelled_clouds import ROAD, UNLABELLED, ground_points, read_street
from roadsight.scene.pavement.ground_raster import cell_means, grow, local_planes, window_planes
from roadsight.scene.pavement.road_surface import (
    KnownRoad,
    RoadSettings,
    driven_line,
    find_road,
    road_points,
)
from roadsight.scene.pavement.scan_levels import level_scans, scanner_positions
from roadsight.scene.whole import road_of

HALF_ROAD_M = 4.0
KERB_M = 0.12
LENGTH_M = 50.0


def street(rng, layer_m=0.0, kerb_m=KERB_M, scans=6, per_m2=60, drive=(15, 35)):
    """Points, intensity, scan and truth of a crowned street with kerbs, walks and lawns.

    Each scan has a blind disc of 3 m around its vehicle, and registration errors of ``layer_m``.
    """
    count = int(LENGTH_M * 24 * per_m2)
    x = rng.uniform(0, LENGTH_M, count)
    y = rng.uniform(-12, 12, count)
    road = np.abs(y) < HALF_ROAD_M
    lawn = np.abs(y) > 7.0
    z = 0.01 * x - 0.02 * np.minimum(np.abs(y), HALF_ROAD_M) + np.where(road, 0.0, kerb_m)
    z += np.where(lawn, rng.normal(0.04, 0.04, count), rng.normal(0, 0.004, count))
    scan = rng.integers(0, scans, count)
    vehicle = np.linspace(*drive, scans)[scan]
    seen = np.hypot(x - vehicle, y - 1.8) > 2.5
    thin = rng.random(count) < np.clip(8.0 / np.maximum(np.hypot(x - vehicle, y - 1.8), 2.5), 0, 1)
    z += rng.normal(0, layer_m, scans)[scan] + rng.normal(0, layer_m / 30, scans)[scan] * (x - 25)
    keep = seen & thin
    xyz = np.column_stack([x, y, z])[keep]
    tone = np.where(lawn, 60.0, np.where(road, 25.0, 35.0)) * rng.uniform(0.8, 1.2, count)
    return xyz, tone[keep], scan[keep], road[keep]


def f1(found, truth):
    return 2 * (found & truth).sum() / (found.sum() + truth.sum())


@pytest.mark.parametrize("layer_m", [0.0, 0.01, 0.03, 0.05])
def test_a_street_ends_at_its_kerbs_whatever_the_registration(rng, layer_m):
    xyz, tone, scan, road = street(rng, layer_m)
    surface = find_road(xyz, tone, scan)
    assert surface.seeded_by == "scans"
    assert f1(road_points(surface, xyz, RoadSettings()), road) > 0.93


@pytest.mark.parametrize("kerb_m", [0.04, 0.08, 0.12, 0.2, 0.5])
def test_where_points_are_dense_the_road_ends_at_its_kerb(rng, kerb_m):
    """Within a cell: windows see a high kerb from farther away than a low one."""
    x, y = rng.uniform([0, -7], [40, 7], (100_000, 2)).T
    z = np.where(np.abs(y) < HALF_ROAD_M, 0.0, kerb_m) + rng.normal(0, 0.004, len(x))
    known = KnownRoad(seeds_xy=np.array([[20.0, 0.0]]))
    surface = find_road(np.column_stack([x, y, z]), known=known)
    row, column = np.nonzero(surface.road)
    x_m, y_m = surface.grid.centres(column, row)
    middle, half = np.abs(x_m - 20) < 12, surface.grid.cell_size_m / 2
    assert y_m[middle].max() + half == pytest.approx(HALF_ROAD_M, abs=0.25)
    assert y_m[middle].min() - half == pytest.approx(-HALF_ROAD_M, abs=0.25)


@pytest.mark.parametrize("gap_m", [2.5, 3.0, 3.5])
@pytest.mark.parametrize(("kerb_m", "noise_m"), [(0.04, 0.004), (0.06, 0.05)])
def test_a_kerb_that_a_gap_hides_is_a_kerb(gap_m, kerb_m, noise_m):
    """Beside the gap it is seen, so that the walk is not reached over it; a road behind is.

    Under noise the walk that was reached over the gap comes up to the kerb from behind.
    """
    rng = np.random.default_rng(1)
    x, y = rng.uniform([0, -7], [60, 12], (120_000, 2)).T
    z = np.where(y < HALF_ROAD_M, 0.0, kerb_m) + rng.normal(0, noise_m, len(x))
    seen = np.hypot(x - 20.0, y - HALF_ROAD_M) > gap_m  # what a vehicle at the kerb does not see
    seen &= np.abs(x - 45.0) > 1.5  # a shadow across the street
    known = KnownRoad(seeds_xy=np.array([[20.0, -2.0]]))
    surface = find_road(np.column_stack([x, y, z])[seen], known=known)
    row, column = np.nonzero(surface.road)
    x_m, y_m = surface.grid.centres(column, row)
    assert y_m.max() < HALF_ROAD_M + 0.5
    assert x_m.max() > 57.0


@pytest.mark.parametrize("layer_m", [0.0, 0.03])
def test_a_vehicle_that_stood_is_no_reason_to_look_across_the_street(rng, layer_m):
    xyz, tone, scan, road = street(rng, layer_m, drive=(25, 25))
    places, sure = scanner_positions(xyz, scan)
    assert sure.all() and np.ptp(places, axis=0).max() < 1.0
    surface = find_road(xyz, tone, scan)
    assert surface.seeded_by == "scans"
    assert f1(road_points(surface, xyz, RoadSettings()), road) > 0.93


def test_a_track_seeds_the_road_where_scans_are_not_told_apart(rng):
    xyz, tone, _, road = street(rng)
    track = np.column_stack([np.linspace(5, 45, 10), np.full(10, 1.8)])
    surface = find_road(xyz, tone, None, KnownRoad(track_xy=track))
    assert surface.seeded_by == "track" and surface.parts == 1
    assert f1(road_points(surface, xyz, RoadSettings()), road) > 0.93


def before(positions):
    """Direction (2,) in which the driven line came to its first position; zero if from nowhere."""
    places = shapely.get_coordinates(driven_line(positions))
    return (places[1] - places[0]) / 5.0


def off_deg(direction, true):
    return np.degrees(np.arccos(np.clip(direction @ true, -1, 1)))


@pytest.mark.parametrize("every_m", [0.6, 1.0, 3.0, 8.0])
def test_a_drive_goes_on_in_its_own_direction_though_its_positions_are_off(every_m):
    off = []
    for draw in range(40):
        rng = np.random.default_rng(draw)
        turn = rng.uniform(0, 2 * np.pi)
        along, across = [np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]
        error = rng.uniform(-0.3, 0.3, (2, 10))
        positions = np.column_stack([every_m * np.arange(10) + error[0], error[1]])
        off.append(off_deg(before(positions @ [along, across]), np.array(along)))
    assert np.sqrt(np.mean(np.square(off))) < 3.0
    assert max(off) < 9.0


@pytest.mark.parametrize(("radius_m", "within_deg"), [(10.0, 8.0), (15.0, 5.0), (30.0, 3.0)])
def test_an_exact_drive_goes_on_along_its_tangent(radius_m, within_deg):
    angle = 0.8 * np.arange(20) / radius_m
    bend = radius_m * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    assert off_deg(before(bend), np.array([1.0, 0.0])) < within_deg


def test_a_vehicle_that_waits_or_turns_round_came_from_where_it_came(rng):
    east = np.column_stack([np.arange(1.0, 60.0), np.zeros(59)])
    waits = np.vstack([rng.normal(0, 0.2, (30, 2)), east])
    assert off_deg(before(waits), np.array([1.0, 0.0])) < 5.0
    out = np.column_stack([np.arange(0, 4.1, 0.5), np.zeros(9)])
    back = np.column_stack([np.arange(4, -20, -0.5), np.full(48, 3.0)])
    np.testing.assert_allclose(before(np.vstack([out, back])), [1.0, 0.0], atol=0.05)


def test_a_vehicle_that_stood_came_from_nowhere(rng):
    np.testing.assert_array_equal(before(np.full((4, 2), 7.0)), [0.0, 0.0])
    np.testing.assert_array_equal(before(rng.uniform(0, 0.03, (9, 2))), [0.0, 0.0])


@pytest.mark.real
def test_a_real_street_is_the_same_road_in_any_direction(data):
    """Whichever way the cells of the grid lie: turned by 37 degrees its walk was a seed (63 %)."""
    street = ground_points(read_street(data / "street_scans" / "08"))
    turn = np.radians(37.0)
    along, across = [np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]
    turned = np.column_stack([street.xyz_m[:, :2] @ [along, across], street.xyz_m[:, 2]])
    found, _ = road_of(turned, street.intensity, street.scan)
    judged = ~np.isin(street.label, UNLABELLED)
    assert f1(found.points[judged], np.isin(street.label, ROAD)[judged]) > 0.8


@pytest.mark.parametrize(("verge", "turn_deg"), [(80.0, 0.0), (80.0, 33.0), (10.0, 60.0)])
def test_without_a_kerb_the_road_ends_where_its_tone_ends(rng, verge, turn_deg):
    """Rough verges that fall by 6 % leave its plane so gently that height says little."""
    count = int(LENGTH_M * 24 * 60)
    x, y = rng.uniform(0, LENGTH_M, count), rng.uniform(-12, 12, count)
    beside = np.maximum(np.abs(y) - HALF_ROAD_M, 0.0)
    road = beside == 0.0
    z = 0.01 * x - 0.06 * beside + rng.normal(0, np.where(road, 0.004, 0.05))
    paint = np.abs(np.abs(y) - HALF_ROAD_M + 0.5) < 0.07
    tone = np.where(paint, 90.0, np.where(road, 25.0, verge)) * rng.uniform(0.8, 1.2, count)
    turn = np.radians(turn_deg)
    along, across = [np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]
    xyz = np.column_stack([np.column_stack([x, y]) @ [along, across], z])
    track = np.array([[5.0, 1.8], [45.0, 1.8]]) @ [along, across]
    surface = find_road(xyz, tone, None, KnownRoad(track_xy=track))
    rows, columns = np.nonzero(surface.road)
    centres = np.column_stack(surface.grid.centres(columns, rows))
    offset = np.abs(centres @ across)
    middle = np.abs(centres @ along - LENGTH_M / 2) < LENGTH_M / 2 - 2
    half_m = middle.sum() * surface.grid.cell_size_m**2 / (LENGTH_M - 4) / 2
    assert half_m == pytest.approx(HALF_ROAD_M, abs=0.15)
    assert offset[middle].max() < HALF_ROAD_M + 0.5


def test_points_far_away_change_nothing(rng):
    xyz, tone, scan, _ = street(rng)
    x, y = rng.uniform(200, 260, (2, 30_000))
    far = np.column_stack([x, y, rng.normal(0, 0.2, len(x))])
    alone = road_points(find_road(xyz, tone, scan), xyz, RoadSettings())
    both = find_road(
        np.concatenate([xyz, far]),
        np.concatenate([tone, np.full(len(far), 30.0)]),
        np.concatenate([scan, np.zeros(len(far), np.int64)]),
    )
    every = np.concatenate([xyz, far])
    found = road_points(both, every, RoadSettings())[: len(xyz)]
    assert (found == alone).mean() > 0.99


def test_too_little_ground_is_refused():
    with pytest.raises(InputError, match="too little ground"):
        find_road(np.zeros((5, 3)))


def test_rough_ground_is_no_road(rng):
    x, y = rng.uniform(0, 30, (2, 30_000))
    xyz = np.column_stack([x, y, rng.normal(0, 0.3, len(x))])
    with pytest.raises(InputError, match="no road found"):
        find_road(xyz)


class TestScans:
    def test_offsets_and_tilts_are_removed(self, rng):
        xyz, _, scan, road = street(rng, layer_m=0.0)
        shift = rng.normal(0, 0.05, 6)
        tilt = rng.normal(0, 0.002, 6)
        moved = xyz.copy()
        moved[:, 2] += shift[scan] + tilt[scan] * (xyz[:, 0] - xyz[:, 0].mean())
        levelled, _ = level_scans(moved, scan)
        # A tilt that all scans share cannot be told from the street's own.
        design = np.column_stack([np.ones(len(xyz)), xyz[:, :2]])[road]
        off = (levelled - xyz[:, 2])[road]
        off -= design @ np.linalg.lstsq(design, off, rcond=None)[0]
        apart = [off[scan[road] == one].mean() for one in range(6)]
        assert np.ptp(apart) < 0.004

    def test_one_scan_keeps_its_heights(self, rng):
        xyz = rng.normal(size=(500, 3))
        levelled, shifts = level_scans(xyz, np.zeros(500, np.int64))
        assert np.array_equal(levelled, xyz[:, 2]) and not shifts.any()

    def test_scanners_stand_in_their_blind_discs(self, rng):
        xyz, _, scan, _ = street(rng, per_m2=200)
        places, sure = scanner_positions(xyz, scan)
        truth = np.column_stack([np.linspace(15, 35, 6), np.full(6, 1.8)])
        assert sure.all()
        assert np.hypot(*(places - truth).T).max() < 1.0

    def test_a_strip_without_blind_disc_has_no_scanner(self, rng):
        xyz = np.column_stack([rng.uniform(0, 40, (40_000, 2)), np.zeros(40_000)])
        _, sure = scanner_positions(xyz, rng.integers(0, 2, len(xyz)))
        assert not sure.any()


class TestRaster:
    def test_windows_recover_a_plane_through_gaps(self, rng):
        x, y = rng.uniform(0, 20, (2, 4000))
        z = 100 + 0.1 * x - 0.05 * y
        cells = cell_means(np.column_stack([x, y, z]), np.ones(len(x)), 0.5)
        height, east, north, residual, _, _ = window_planes(
            cells.weight, cells.height_m, cells.across, cells.up, 3.0
        )
        inner = (slice(8, -8), slice(8, -8))
        column, row = np.meshgrid(np.arange(cells.grid.columns), np.arange(cells.grid.rows))
        east_m, north_m = cells.grid.centres(column, row)
        expected = 100 + 0.1 * east_m - 0.05 * north_m
        assert np.abs(height - expected)[inner].max() < 0.02
        assert np.abs(east / 0.5 - 0.1)[inner].max() < 0.01
        assert np.abs(north / 0.5 + 0.05)[inner].max() < 0.01
        assert residual[inner].max() < 0.05

    def test_sparse_cells_take_a_larger_scale(self, rng):
        dense = rng.uniform(0, 10, (5000, 2))
        sparse = rng.uniform(0, 10, (300, 2)) + np.array([10.0, 0.0])
        xy = np.concatenate([dense, sparse])
        cells = cell_means(np.column_stack([xy, np.zeros(len(xy))]), np.ones(len(xy)), 0.25)
        planes = local_planes(cells, (1.5, 2.5, 4.0, 6.5), 0.005)
        west = planes.scale_m[:, 4:30][planes.known[:, 4:30]]
        east = planes.scale_m[:, 50:70][planes.known[:, 50:70]]
        assert np.median(west) < np.median(east)


def growth(height, seed, step=0.02):
    """Growth over heights (rows, columns) with nothing else to end it."""
    shape = height.shape
    nothing = np.zeros(shape)
    return grow(
        seed, np.ones(shape, bool), np.zeros(shape, bool), height, nothing, nothing,
        np.zeros((*shape, 1)), np.array([4.0]), np.array([0.1]), np.array([np.inf]),
        np.full(shape, step), nothing, 1.0, 6.0, 3, 2, 0.3,
    )  # fmt: skip


def test_growth_stops_at_a_step_and_at_a_gap_narrower_than_a_vehicle():
    height = np.zeros((60, 60))
    height[:, 30:] = 0.1
    seed = np.zeros((60, 60), bool)
    seed[28:33, 8:13] = True
    grown = growth(height, seed)
    assert grown[5:55, 5:26].all() and not grown[:, 31:].any()
    height[28:31, 28:32] = np.linspace(0, 0.1, 4)
    assert not growth(height, seed)[:, 36:].any()
