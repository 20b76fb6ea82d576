"""Stages of the pole job: moving, turning, mirroring and shuffling a drive changes no pole."""

import numpy as np
import pandas as pd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadsight.base.sections.poles import Hazard
from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.poles.drive.videolog import headings_deg
from roadsight.poles.images.image_edges import trace_edges
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pole_masks import find_instances
from roadsight.poles.risk.roads import RouteTracks
from roadsight.scene.terrain.tin import add_cells, cell_means, sum_cells
from roadsight.scene.terrain.tin import triangulate as make_terrain
from roadsight.scene.voxel_classes import (
    VoxelGrid,
    add_runs,
    count_classes,
    seen_from_above,
    settle,
)
from tests.helpers.pole_street import found, street
from tests.helpers.rated_poles import rate_poles

SEEDS = st.integers(0, 2**31)
ANGLES = st.floats(-180.0, 180.0)
FAR = st.tuples(*[st.integers(-5_000_000, 5_000_000)] * 2)
FEW = settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
RULES = Hazard(design_speed_kmh=80, aadt=3000, dense_per_km=35.0)
"""Density off the whole tens that a window of 100 m gives."""


def moves(angle_deg, mirror):
    """Matrix (2, 2) that turns counter-clockwise, after mirroring left and right if asked."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[cosine, -sine], [sine, cosine]]) @ np.diag([-1.0 if mirror else 1.0, 1.0])


def paired(first, second):
    """Rows of the second that are nearest to those of the first."""
    gaps = first[:, None] - second
    return np.hypot(gaps[..., 0], gaps[..., 1]).argmin(axis=1)


@FEW
@given(seed=SEEDS, angle=ANGLES, mirror=st.booleans(), far=FAR)
def test_poles_move_turn_and_mirror_with_the_cameras(seed, angle, mirror, far):
    """To a hundredth of a millimetre, also 5,000 km away; errors, scores and reasons alike."""
    rows, move = street(seed, 6, 0.2, 0.05)[1], moves(angle, mirror)
    shift = np.array(far) + 0.5
    there = rows.copy()
    there[:, :2] = rows[:, :2] @ move.T + shift
    way = np.column_stack([np.sin(np.radians(rows[:, 2])), np.cos(np.radians(rows[:, 2]))])
    there[:, 2] = np.degrees(np.arctan2(*(way @ move.T).T))
    here, moved = found(rows), found(there)
    assert len(here) == len(moved) > 0
    expected = here[["x", "y"]].to_numpy() @ move.T + shift
    moved = moved.iloc[paired(expected, moved[["x", "y"]].to_numpy())].reset_index(drop=True)
    np.testing.assert_allclose(moved[["x", "y"]], expected, rtol=0, atol=1e-5)
    for name in ("sigma_major_m", "sigma_minor_m", "condition"):
        np.testing.assert_allclose(moved[name], here[name], rtol=1e-4)
    for name in ("score", "kept", "reason"):
        assert moved[name].tolist() == here[name].tolist()


@FEW
@given(seed=SEEDS)
def test_poles_do_not_depend_on_the_order_or_repeats_of_sightings(seed):
    rng = np.random.default_rng(seed)
    rows = street(seed, 6, 0.2, 0.05)[1]
    again = np.concatenate([rows, rows[rng.integers(0, len(rows), 9)]])
    here = found(rows)
    pd.testing.assert_frame_equal(found(rng.permutation(again)), here, check_exact=True)


@FEW
@given(seed=SEEDS, angle=ANGLES, mirror=st.booleans(), far=FAR)
def test_headings_turn_and_mirror_with_the_track(seed, angle, mirror, far):
    rng = np.random.default_rng(seed)
    turn = np.cumsum(rng.normal(0, 0.05, 30))
    xy = np.cumsum(8.0 * np.column_stack([np.sin(turn), np.cos(turn)]), axis=0)
    xy = xy + rng.normal(0, 0.3, xy.shape)
    there = xy @ moves(angle, mirror).T + np.array(far) + 0.5
    sign = -1.0 if mirror else 1.0
    for here, moved in zip(headings_deg(xy), headings_deg(there), strict=True):
        assert np.abs(wrap_deg(moved - (sign * here - angle))).max() < 1e-4
    backwards = headings_deg(xy[::-1])[0][::-1]
    assert np.abs(wrap_deg(backwards - headings_deg(xy)[0] - 180)).max() < 1e-6


def scene_image(seed):
    """A mask with a road, two markings and some poles."""
    rng = np.random.default_rng(seed)
    mask = np.full((400, 640), int(PixelClass.SKY), np.uint8)
    rows = np.arange(160, 400)
    for v in rows:
        half = 20 + 1.1 * (v - 160)
        left, right = int(320 - half), int(320 + half)
        mask[v, max(left - 60, 0) : right + 60] = int(PixelClass.VEGETATION)
        mask[v, max(left, 0) : right] = int(PixelClass.ROAD)
        for side in (-1, 1):
            middle = int(320 + side * 0.8 * half)
            mask[v, max(middle - 2, 0) : middle + 3] = int(PixelClass.MARKING)
    for u in rng.choice(np.r_[20:200:25, 450:620:25], 5, replace=False):
        mask[60:230, u : u + 6] = int(PixelClass.POLE)
    return mask


@FEW
@given(seed=SEEDS)
def test_poles_in_masks_are_mirrored_with_the_image(seed):
    mask = scene_image(seed)
    here = [one for one in find_instances(mask) if not one.reason]
    there = [one for one in find_instances(mask[:, ::-1].copy()) if not one.reason][::-1]
    assert len(here) == len(there) > 0
    for a, b in zip(here, there, strict=True):
        assert abs(a.u_foot + b.u_foot - 639) < 0.5 and abs(a.v_foot - b.v_foot) < 0.5
        assert (a.foot, a.width_px, a.pixels) == (b.foot, b.width_px, b.pixels)


@FEW
@given(seed=SEEDS)
def test_edges_in_masks_are_mirrored_with_the_image(seed):
    """Left becomes right; a thinned line of even width may lie on either of its two middles."""
    mask = scene_image(seed)
    here, there = trace_edges(mask), trace_edges(mask[:, ::-1].copy())
    assert abs(len(here.side) - len(there.side)) <= 0.05 * len(here.side)
    for side in (-1, 1):
        for lane in (True, False):
            a = here.uv_px[(here.side == side) & (here.is_lane == lane)]
            b = there.uv_px[(there.side == -side) & (there.is_lane == lane)] * [-1, 1] + [639, 0]
            assert (len(a) == 0) == (len(b) == 0)
            if len(a):
                gaps = np.hypot(*(a[:, None] - b).transpose(2, 0, 1)).min(axis=1)
                assert np.quantile(gaps, 0.95) <= 2.0


@FEW
@given(seed=SEEDS, angle=ANGLES, mirror=st.booleans())
def test_hazards_turn_and_mirror_with_the_road(seed, angle, mirror):
    rng = np.random.default_rng(seed)
    move = moves(angle, mirror)
    track = np.column_stack([np.zeros(30), 8.0 * np.arange(30)])
    edges = np.column_stack([np.repeat([-3.5, 3.5], 400), np.tile(np.linspace(0, 232, 400), 2)])
    aside = rng.choice([-1, 1], 8) * rng.uniform(4, 12, 8)
    poles = np.column_stack([aside, rng.uniform(20, 200, 8)])
    back = np.linalg.inv(move)

    def rated(by, height):
        frames = pd.DataFrame(track @ by.T, columns=["x", "y"]).assign(
            route="r", sequence=range(30)
        )
        table = pd.DataFrame(poles @ by.T, columns=["x", "y"]).assign(sigma_major_m=0.2)
        return rate_poles(table, edges @ by.T, RouteTracks(frames), height, RULES)

    def slope(x, y):
        return -0.18 * np.maximum(np.abs(x) - 3.5, 0) + 0.001 * y

    here = rated(np.eye(2), slope)
    there = rated(move, lambda x, y: slope(*(np.column_stack([x, y]) @ back.T).T))
    numbers = ["offset_m", "clear_zone_m", "slope_rise_over_run", "station_m", "objects_per_km"]
    np.testing.assert_allclose(there[numbers].astype(float), here[numbers].astype(float), atol=1e-6)
    assert there["rating"].tolist() == here["rating"].tolist()
    same = there["side"].to_numpy() == here["side"].to_numpy()
    assert (~same if mirror else same).all()


@FEW
@given(seed=SEEDS, parts=st.integers(1, 7), far=FAR)
def test_voxels_do_not_depend_on_order_tiles_or_place(seed, parts, far):
    """Voxels are anchored in the map: a cloud that moves by whole voxels keeps them."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(0, 12, (4000, 3)).astype(np.float32)
    cls = rng.choice(np.array([2, 5, 6, 11], np.uint8), 4000)
    order = rng.permutation(4000)

    def seen(origin, tiles):
        grid = VoxelGrid.over(Frame(origin), 0.5, [*xyz.min(axis=0), *xyz.max(axis=0)])
        runs = [count_classes(grid, list(xyz[part].T), cls[part]) for part in tiles]
        columns = seen_from_above(grid, settle(add_runs(runs)))
        return np.column_stack([columns.row, columns.column, columns.cls, columns.height_m])

    here = seen((0.0, 0.0, 0.0), [np.arange(4000)])
    there = seen((float(far[0]), float(far[1]), 100.0), np.array_split(order, parts))
    np.testing.assert_allclose(there, here, atol=1e-9)


@FEW
@given(seed=SEEDS, parts=st.integers(1, 7), cells=st.tuples(*[st.integers(-100_000, 100_000)] * 2))
def test_terrain_does_not_depend_on_order_tiles_or_place(seed, parts, cells):
    rng = np.random.default_rng(seed)
    xyz = np.round(rng.uniform(0, 30, (3000, 3)) * [1, 1, 0.1], 4)
    road, order = rng.random(3000) < 0.3, rng.permutation(3000)
    shift = np.array([*cells, 0.0])
    tiles = [sum_cells(xyz[part] + shift, road[part], 1.0) for part in np.array_split(order, parts)]
    here = make_terrain(cell_means(sum_cells(xyz, road, 1.0)), 5.0)
    there = make_terrain(cell_means(add_cells(tiles)), 5.0)
    np.testing.assert_allclose(there.vertices - shift, here.vertices, atol=2e-4)
    shared = len(set(map(tuple, here.triangles)) & set(map(tuple, there.triangles)))
    assert shared >= 0.999 * len(here.triangles)
