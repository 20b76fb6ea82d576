from unittest import mock

import cv2
import numpy as np
import pyogrio
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.base.sections.poles import RoadEdges
from roadsight.geometry.frames import Frame
from roadsight.io.raster.top_rasters import TopRasterWriter, read_top
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_about, read_table
from roadsight.scene import road_edges
from roadsight.scene.road_edges import (
    between_pixels,
    clean_road,
    closing_radius,
    edge_level,
    edge_lines,
    edge_pixels,
    in_survey,
    outlines,
    without_small,
)
from roadsight.scene.voxel_classes import VoxelGrid, count_classes, seen_from_above, settle
from roadsight.stages.scene import extract_road_edges
from roadsight.stages.scene.extract_road_edges import medians, surface_heights

CELL = 0.3048
FRAME = Frame((2_000_000.0, 640_000.0, 300.0), CELL, CELL)


def road_cloud(
    seed=1, density=30.0, turn_deg=25.0, half_m=3.5, size=(70.0, 50.0), shift=(0.0, 0.0)
):
    """Straight road through the middle, crown 2 %, grade 3 %, verge falling 10 %."""
    rng = np.random.default_rng(seed)
    x, y = (rng.uniform(0, s, int(density * size[0] * size[1])) for s in size)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    along = (x - size[0] / 2) * c + (y - size[1] / 2) * s
    aside = -(x - size[0] / 2) * s + (y - size[1] / 2) * c
    z = height(along, aside, half_m) + rng.normal(0, 0.015, len(x))
    cls = np.where(np.abs(aside) < half_m, 11, 2).astype(np.uint8)
    xyz = np.column_stack([x + shift[0], y + shift[1], z]).astype(np.float32)
    return xyz, cls, (c, s, size, shift)


def height(along, aside, half_m=3.5):
    away = np.abs(aside)
    return 5 + 0.03 * along - 0.02 * np.minimum(away, half_m) - 0.1 * np.maximum(away - half_m, 0)


def on_road(xy, turn):
    c, s, size, shift = turn
    x, y = xy[:, 0] - size[0] / 2 - shift[0], xy[:, 1] - size[1] / 2 - shift[1]
    return x * c + y * s, -x * s + y * c


def write_top(folder, xyz, cls):
    grid = VoxelGrid.over(FRAME, CELL, [*xyz.min(axis=0), *xyz.max(axis=0)])
    voxels = settle(count_classes(grid, list(xyz.T.copy()), cls))
    with TopRasterWriter(folder / "top.tif", FRAME, grid) as top:
        top.add(seen_from_above(grid, voxels))
    write_json(folder / "frame.json", FRAME.to_dict())


def extract(folder, *extra, code=0):
    names = {"top": "tif", "frame": "json", "edges": "parquet", "lines": "gpkg"}
    paths = [f"--{name}={folder / name}.{end}" for name, end in names.items()]
    assert extract_road_edges.main([*paths, *extra]) == code
    return None if code else read_table(folder / "edges.parquet")


@pytest.mark.parametrize("density", [6.0, 30.0])
def test_edges_lie_on_the_true_edges_and_ends_are_none(tmp_path, density):
    xyz, cls, turn = road_cloud(density=density)
    write_top(tmp_path, xyz, cls)
    edges = extract(tmp_path)
    along, aside = on_road(edges[["x", "y"]].to_numpy(), turn)
    error = np.abs(aside) - 3.5
    bound = 0.05 if density > 10 else 0.12
    assert abs(np.median(error)) < bound / 2
    assert np.sqrt(np.mean(error**2)) < bound
    assert np.abs(error).max() < 4 * bound  # nothing crosses the road where it is cut
    assert np.abs(edges["z"] - height(along, aside)).max() < 0.05
    sides = np.sign(aside)
    assert edges.groupby("polyline").ngroups == 2
    for side in (-1, 1):
        station = np.sort(along[sides == side])
        assert np.diff(station).max() < 0.3
        assert station[-1] - station[0] > 60
    tangent = edges[["tangent_x", "tangent_y"]].to_numpy()
    np.testing.assert_allclose(np.hypot(*tangent.T), 1.0, atol=1e-9)
    off = np.degrees(np.arcsin(np.abs(tangent @ [-turn[1], turn[0]])))
    assert np.percentile(off, 90) < (3 if density > 10 else 8)
    assert read_about(tmp_path / "edges.parquet")["cell_size_m"] == pytest.approx(CELL)
    lines = pyogrio.read_dataframe(tmp_path / "lines.gpkg", layer="road_edges")
    assert len(lines) == 2
    native = np.array(lines.geometry[0].coords)
    own = edges.loc[edges["polyline"] == 0, ["x", "y", "z"]].to_numpy()
    np.testing.assert_allclose(FRAME.to_local(native), own, atol=1e-6)


def test_pixels_are_the_papers_edge_pixels_and_coarser(tmp_path):
    xyz, cls, turn = road_cloud()
    write_top(tmp_path, xyz, cls)
    pixels = extract(tmp_path, "--method", "pixels")
    _, aside = on_road(pixels[["x", "y"]].to_numpy(), turn)
    assert (pixels["polyline"] == -1).all()
    error = np.abs(aside) - 3.5
    assert np.abs(error).max() < 2 * CELL
    local = pixels[["x", "y"]].to_numpy() / CELL
    np.testing.assert_allclose(local % 1.0, 0.5, atol=1e-4)
    assert np.std(error) > 0.08  # what the outline is for
    assert set(pyogrio.read_dataframe(tmp_path / "lines.gpkg").geometry.geom_type) == {"Point"}


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 40), st.integers(0, 40))
def test_moving_the_image_moves_the_edges(rows, columns):
    rng = np.random.default_rng(0)
    r, c = np.mgrid[:80, :120]
    share = np.clip(12 - np.abs(r - 40 - 0.1 * c) + 0.5, 0, 1) * (rng.random(r.shape) > 0.1)
    found = []
    for shift in ((0, 0), (rows, columns)):
        pad = ((shift[0], 3), (shift[1], 5))
        part = np.pad(share, pad)
        full = np.pad(np.ones(share.shape, bool), pad)
        image = clean_road(part > 0, full, CELL, RoadEdges())
        rings = outlines(image, edge_level(part, full, image), 2.0)
        lines = edge_lines(rings, image, CELL, RoadEdges())
        cuts = np.flatnonzero(np.diff(lines.polyline)) + 1
        found.append(np.split(lines.place - shift, cuts))
    line = shapely.MultiLineString(found[0])
    gap = shapely.distance(line, shapely.points(np.concatenate(found[1])))
    assert len(found[0]) == len(found[1]) == 2
    assert np.percentile(gap, 95) < 0.05
    assert gap.max() < 1.0  # the ends may lie a step further


def test_small_holes_and_islands_have_no_edge_and_large_ones_do():
    share = np.zeros((120, 160))
    share[30:90, :] = 1.0
    share[50:56, 20:26] = 0.0  # 3 m2: a car
    share[45:75, 80:110] = 0.0  # 84 m2: an island
    share[5:12, 40:47] = 1.0  # 5 m2 of road in a field
    full = np.ones(share.shape, bool)
    image = clean_road(share > 0, full, CELL, RoadEdges())
    assert image.road[53, 23] and not image.road[60, 95] and not image.road[8, 43]
    lines = edge_lines(
        outlines(image, edge_level(share, full, image), 2.0), image, CELL, RoadEdges()
    )
    row, column = lines.place.T
    around = (row > 40) & (row < 80) & (column > 70) & (column < 120)
    assert lines.polyline[around].min() == lines.polyline[around].max()
    assert set(np.round(row[~around] - 0.5)) <= {29, 89}
    assert len(np.unique(lines.polyline)) == 3


def test_edge_against_the_unknown_is_no_edge():
    share = np.zeros((60, 100))
    share[20:40, :] = 1.0
    full = np.ones(share.shape, bool)
    full[40:, :] = False  # nothing was surveyed beyond the lower side
    image = clean_road(share > 0, full, CELL, RoadEdges())
    rows, _ = np.nonzero(edge_pixels(image, 1.5))
    assert set(rows) == {20}
    lines = edge_lines(
        outlines(image, edge_level(share, full, image), 2.0), image, CELL, RoadEdges()
    )
    assert np.abs(lines.place[:, 0] - 19.5).max() < 0.6


def test_nothing_in_nothing_out(tmp_path):
    blank = np.zeros((40, 40), bool)
    image = clean_road(blank, ~blank, CELL, RoadEdges())
    assert not image.road.any()
    assert outlines(image, edge_level(blank.astype(float), ~blank, image), 2.0) == []
    assert len(edge_lines([], image, CELL, RoadEdges()).place) == 0
    xyz, cls, _ = road_cloud(density=2.0, size=(30.0, 30.0))
    write_top(tmp_path, xyz, np.full_like(cls, 2))
    extract(tmp_path, code=2)
    assert not (tmp_path / "edges.parquet").exists()


def test_sparse_clouds_are_closed_wider():
    road = np.ones((200, 200), bool)
    rng = np.random.default_rng(0)
    radii = [closing_radius(rng.random(road.shape) < p, road, 1) for p in (1.0, 0.6, 0.3, 0.02)]
    assert radii == sorted(radii) and radii[0] == 1 and radii[-1] == 6
    assert closing_radius(road, np.zeros_like(road), 2) == 2


def test_surface_heights_ignore_what_stands_on_the_road():
    r, c = np.mgrid[:40, :40]
    z = (10 + 0.01 * r - 0.02 * c).astype(np.float32)
    road = c < 20
    dirty = z.copy()
    dirty[10:14, 15:19] += 1.5  # a car
    place = np.array([[12.3, 19.5], [30.0, 19.5], [5.0, 39.0]])
    found = surface_heights(place, dirty, road)
    np.testing.assert_allclose(found[:2], 10 + 0.01 * place[:2, 0] - 0.02 * place[:2, 1], atol=0.01)
    assert np.isnan(found[2])


@given(st.integers(0, 10**6))
def test_surface_heights_are_those_of_planes_fitted_one_by_one(seed):
    rng = np.random.default_rng(seed)
    z = (rng.normal(0, 0.1, (12, 14)) + 100).astype(np.float32)
    road = rng.random(z.shape) < rng.random()
    z[rng.random(z.shape) < 0.1] = np.nan
    place = rng.uniform(-6, 18, (20, 2))
    expected = [_plane_at(at, z, road) for at in place]
    np.testing.assert_allclose(surface_heights(place, z, road), expected, atol=1e-6)


def _plane_at(place, z, road):
    """Height at one place, by least squares with two more observations: the slopes are flat."""
    row, column = (index.ravel() for index in np.indices(z.shape))
    near = (np.abs(row - np.round(place[0])) <= 4) & (np.abs(column - np.round(place[1])) <= 4)
    near &= road.ravel() & np.isfinite(z.ravel())
    if not near.any():
        return np.nan
    height = z.ravel()[near].astype(float)
    middle = np.median(height)
    close = np.abs(height - middle) <= 0.3
    terms = np.column_stack([np.ones(close.sum()), row[near][close], column[near][close]])
    terms[:, 1:] -= place
    known = np.vstack([terms, np.diag(np.sqrt([1e-9, 0.3, 0.3]))])
    apart = np.append(height[close] - middle, np.zeros(3))
    return middle + np.linalg.lstsq(known, apart, rcond=None)[0][0]


@given(st.integers(0, 10**6), st.integers(1, 12))
def test_medians_are_those_of_the_valid(seed, width):
    rng = np.random.default_rng(seed)
    values = rng.integers(-9, 9, (30, width)) / 4
    valid = rng.random(values.shape) < rng.random((30, 1))
    expected = [
        np.median(row[own]) if own.any() else np.nan for row, own in zip(values, valid, strict=True)
    ]
    np.testing.assert_array_equal(medians(values, valid), expected)


def whole_level(share, occupied, image):
    """The level of every pixel, then cut off inside and outside."""
    sigma = max(0.7, 0.5 * image.closing)
    weight = cv2.GaussianBlur(occupied.astype(np.float32), (0, 0), sigma)
    blurred = cv2.GaussianBlur(np.where(occupied, share, 0).astype(np.float32), (0, 0), sigma)
    road = image.road.astype(np.uint8)
    level = np.where(weight > 1e-3, blurred / np.maximum(weight, 1e-3), road)
    step = np.arange(-image.closing - 2, image.closing + 3)
    disc = (np.hypot(step[:, None], step) <= image.closing + 2.25).astype(np.uint8)
    level[cv2.erode(road, disc, borderValue=1) > 0] = 1
    level[cv2.dilate(road, disc, borderValue=0) == 0] = 0
    return level


@pytest.mark.parametrize(("density", "block"), [(30.0, 256), (30.0, 37), (6.0, 256), (6.0, 50)])
def test_level_near_the_road_is_that_of_the_whole_image(tmp_path, monkeypatch, density, block):
    monkeypatch.setattr(road_edges, "_BLOCK", block)
    xyz, cls, _ = road_cloud(density=density)
    write_top(tmp_path, xyz, cls)
    top = read_top(tmp_path / "top.tif", FRAME)
    occupied = top.cls > 0
    image = clean_road(top.cls == 11, occupied, CELL, RoadEdges())
    level = edge_level(top.road_share, occupied, image)
    assert 0 < level[level > 0].min() < 0.5
    # Vectors of single precision end elsewhere, which may change the last bit.
    np.testing.assert_allclose(level, whole_level(top.road_share, occupied, image), atol=2e-7)


def patches(seed, shape, share):
    """Mask with some large patches, some small ones and some single pixels."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), 1.5)
    mask = (noise > np.quantile(noise, 1 - share)) ^ (rng.random(shape) < 0.02)
    return mask.astype(np.uint8)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.tuples(st.integers(1, 90), st.integers(1, 90)),
    st.floats(0.05, 0.95),
    st.sampled_from([0.0, 1.0, 2.0, 3.5, 9.0, 40.0, 1e12]),
)
def test_small_components_are_those_of_the_whole_mask(seed, shape, share, least):
    mask = patches(seed, shape, share)
    count, labels = cv2.connectedComponents(mask, connectivity=4)
    expected = np.zeros_like(mask)
    for number in range(1, count):
        own = labels == number
        expected[own] = own.sum() >= least
    with mock.patch.object(road_edges, "_LABELS_BLOCK", 16):
        np.testing.assert_array_equal(without_small(mask, least), expected)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([0.0, 0.05, 0.5, 1.0]),
    st.sampled_from([0.0, 1.5, 2.5, 7.0]),
)
def test_survey_ends_where_the_distances_of_the_whole_image_say(seed, share, border):
    rng = np.random.default_rng(seed)
    road = np.zeros(rng.integers(1, 80, 2), bool)
    surveyed = rng.random(np.add(road.shape, 6)) >= share
    image = road_edges.RoadImage(road, surveyed, 1)
    places = rng.uniform(-2, np.add(road.shape, 2), (200, 2))
    places[:60] = np.round(places[:60])
    known = np.argwhere(~surveyed) - 3.0
    with mock.patch.object(road_edges, "_BLOCK", 16):
        found = in_survey(image, places, border)
    assert len(in_survey(image, places[:0], border)) == 0
    if not len(known):
        assert found.all()
        return
    pixels = np.stack(np.indices(road.shape), axis=-1)
    gap = np.linalg.norm(pixels[:, :, None] - known, axis=-1).min(axis=-1).astype(np.float32) - 0.5
    np.testing.assert_array_equal(found, between_pixels(gap, *places.T) > border)


def test_batches_of_places_move_as_all_of_them_do(tmp_path):
    xyz, cls, _ = road_cloud(density=20.0)
    write_top(tmp_path, xyz, cls)
    top = read_top(tmp_path / "top.tif", FRAME)
    image = clean_road(top.cls == 11, top.cls > 0, CELL, RoadEdges())
    level = edge_level(top.road_share, top.cls > 0, image)
    expected = outlines(image, level, 2.0)
    with mock.patch.object(road_edges, "_BATCH", 7):
        for found, ring in zip(outlines(image, level, 2.0), expected, strict=True):
            np.testing.assert_array_equal(found, ring)
