"""Voxels, the overhead road image and the terrain."""

from __future__ import annotations

from collections import Counter

import numpy as np
from scipy.spatial import Delaunay

from roadsight.base.arrays import Numbers
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import RoadEdges
from roadsight.geometry.frames import Frame
from roadsight.geometry.ray_casting import RayScene
from roadsight.scene.road_edges import clean_road, edge_level, edge_lines, outlines, smoothing_cells
from roadsight.scene.terrain.tin import (
    Terrain,
    TerrainSight,
    add_cells,
    cell_means,
    sum_cells,
    triangulate,
)
from roadsight.scene.voxel_classes import VoxelGrid, add_runs, count_classes, settle
from roadsight_hardcases.case import Errors, fails, hard_case

# Easting and northing of a place in UTM, m: there, single precision has steps of 0.5 m.
_FAR = np.array([632_000.0, 6_543_000.0, 0.0])


@hard_case("rasterise_lidar", bound=0.001, unit="share of points in another voxel")
def points_on_voxel_faces(rng: np.random.Generator) -> Errors:
    """Clouds in whole centimetres put points on voxel faces, where rounding picks the side."""
    true = np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    native = np.round(true * 0.1 + [500.0, 300.0, 20.0], 2)
    naive = np.floor(native / 0.1).astype(int) != np.add(true, [5000, 3000, 200])
    frame = Frame((500.0, 300.0, 20.0))
    local = frame.to_local(native).astype(np.float32)
    grid = VoxelGrid.over(frame, 0.1, np.concatenate([local.min(axis=0), local.max(axis=0)]))
    runs = count_classes(grid, list(local.T), np.ones(len(local), np.uint8))
    found = set(map(tuple, (grid.indices(runs.voxel) - [5000, 3000, 200]).tolist()))
    return naive.any(axis=1).mean(), len(found ^ set(map(tuple, true.tolist()))) / len(true)


@hard_case("rasterise_lidar", bound=0.001, unit="share of voxels of another class")
def votes_that_tie(rng: np.random.Generator) -> Errors:
    """Where classes tie, the first point of the file decides: another order, another map."""
    xyz = rng.uniform(0, 8, (3000, 3))
    cls = rng.choice(np.array([2, 3, 5], np.uint8), 3000)
    grid = VoxelGrid.over(Frame((0.0, 0.0, 0.0)), 1.0, [0, 0, 0, 8, 8, 8])

    def counted(order: Numbers) -> tuple[list[int], Numbers]:
        voxels: dict[tuple[int, ...], Counter[int]] = {}
        for place, kind in zip(np.floor(xyz[order]).tolist(), cls[order].tolist(), strict=True):
            voxels.setdefault(tuple(place), Counter())[kind] += 1
        naive = [voxels[key].most_common(1)[0][0] for key in sorted(voxels)]
        parts = [
            count_classes(grid, list(xyz[rows].T), cls[rows]) for rows in np.array_split(order, 3)
        ]
        return naive, settle(add_runs(parts)).cls

    here, there = counted(np.arange(3000)), counted(rng.permutation(3000))
    naive = np.mean(np.array(here[0]) != there[0])
    return naive, np.mean(here[1] != there[1])


@hard_case("extract_road_edges", bound=1.0, unit="m of edge that is none")
def where_the_data_end(rng: np.random.Generator) -> Errors:
    """The outline of a road runs along the end of the data, where no edge of the road is."""
    share = np.zeros((260, 120), np.float32)
    share[:, 40:80] = 1.0
    occupied, is_road = np.ones(share.shape, bool), share > 0
    settings = RoadEdges()
    image = clean_road(is_road, occupied, 0.3, settings)
    rings = outlines(
        image, edge_level(share, occupied, image), smoothing_cells(image, 0.3, settings)
    )
    ring = np.concatenate(rings)
    across = (ring[:, 0] < 0.5) | (ring[:, 0] > 258.5)
    steps = np.hypot(*np.diff(ring, axis=0, append=ring[:1]).T) * 0.3
    lines = edge_lines(rings, image, 0.3, settings)
    off = np.minimum(np.abs(lines.place[:, 1] - 39.5), np.abs(lines.place[:, 1] - 79.5)) > 1.0
    missing = max(0.0, 140.0 - len(lines.place) * settings.spacing_m)
    return steps[across].sum(), off.sum() * settings.spacing_m + missing


@hard_case("build_terrain", bound=0.001, unit="share of the points lost")
def delaunay_at_map_size(rng: np.random.Generator) -> Errors:
    """At map coordinates the triangulation silently drops much of its points."""
    xy = rng.uniform(0, 40, (6000, 2))
    points = np.add(np.column_stack([xy, np.zeros(6000)]), [500_000, 6_543_000, 0])
    naive = len(Delaunay(points[:, :2]).coplanar)
    ours = len(points) - len(triangulate(points, 5.0).vertices)
    return naive / 6000, ours / 6000


@hard_case("build_terrain", bound=0.5, unit="unexplained failures")
def terrain_along_one_line(rng: np.random.Generator) -> Errors:
    """Points on one line, or fewer than three, stop the triangulation with an inner error."""
    line = np.linspace(0, 50, 30)[:, None] * [1.0, 2.0, 0.0]
    naive = ours = 0.0
    for points in (line, line[:2], line[:0]):
        naive += fails(Delaunay, points[:, :2], expected=(InputError,))
        ours += fails(triangulate, points, 5.0, expected=(InputError,))
    return naive, ours


@hard_case("build_terrain", bound=0.5, unit="cells whose height has other digits")
def sums_in_another_order(rng: np.random.Generator) -> Errors:
    """Sums of floating numbers differ with the tiles: two cores give other bytes than one."""
    xyz = rng.uniform(0, 50, (40_000, 3))
    road = np.zeros(len(xyz), bool)

    def means(order: Numbers, parts: int) -> tuple[Numbers, Numbers]:
        rows = np.array_split(order, parts)
        sums = add_cells([sum_cells(xyz[part], road[part], 5.0) for part in rows])
        cell = (np.floor(xyz[:, 1] / 5) * 10 + np.floor(xyz[:, 0] / 5)).astype(int)
        naive = sum(np.bincount(cell[part], xyz[part, 2], 100) for part in rows)
        return naive / np.bincount(cell), cell_means(sums)

    here, there = means(np.arange(len(xyz)), 1), means(rng.permutation(len(xyz)), 7)
    return np.count_nonzero(here[0] != there[0]), np.count_nonzero(here[1] != there[1])


@hard_case("align_cameras", bound=0.01, unit="share of points judged wrongly")
def terrain_far_from_the_origin(rng: np.random.Generator) -> Errors:
    """Rays against terrain at map coordinates, in single precision, hide what is in the open."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(0, 60.0, 0.7), np.arange(0, 60.0, 0.7)))
    local = np.column_stack([x, y, 4 * np.sin((x + y) / 5)])
    triangles = Delaunay(local[:, :2]).simplices.astype(np.int32)
    points = np.column_stack([rng.uniform(5, 55, (800, 2)), np.zeros(800)])
    points[:, 2] = 4 * np.sin(points[:, :2].sum(axis=1) / 5) + 0.05
    camera = np.array([30.0, 1.0, 9.0])
    true = TerrainSight(Terrain(local, triangles)).visible(camera, points)
    ours = TerrainSight(Terrain(local + _FAR, triangles)).visible(camera + _FAR, points + _FAR)
    scene = RayScene(local + _FAR, triangles, robust=True)
    origin = (camera + _FAR).astype(np.float32)
    way = (points + _FAR).astype(np.float32) + np.array([0, 0, 0.15], np.float32) - origin
    naive = ~scene.occluded(origin, way, 0.9999)
    return np.mean(naive != true), np.mean(ours != true)
