"""Pavement outline from smooth ground points: vote, connected road, polygons (section 2.2)."""

from __future__ import annotations

import numpy as np
import shapely
from rasterio import features
from rasterio.transform import Affine
from scipy import ndimage
from shapely import MultiPolygon, Polygon
from shapely.geometry import shape

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.kernels import compiled, compiled_part
from roadsight.base.sections.scene import GroundClasses, PavementOutline, Thinning
from roadsight.geometry.areas import inside
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.fpfh import nearest_neighbours, plane_residuals_m
from roadsight.scene.pavement.open3d_engine import open3d_clusters

_USUAL = GroundClasses().thinning
_SMALLEST_AREA_M2 = 200.0  # Less pavement than this is no road.
# Three quarters of a pavement's points depart less than this from a local plane.
_ROUGHEST_M = 0.05
# Points of the thinned surface that a place's plane goes through: the ring around it.
_PLANE_NEIGHBOURS = 8
_HINT = "give the monitored area as a polygon (placement.tma) or raise pavement.voxel_size_m"


def pavement_settings_for(
    column_m: float, settings: PavementOutline, thinning: Thinning = _USUAL
) -> PavementOutline:
    """Distances of the outline at least a few thinned columns wide; with voxels, as they are set.

    Raises
    ------
    InputError : voxels, and a distance of clusters that is less than their size: the paper wants no
        value below the spacing of the points (section 3.2), to which voxels were widened.
    """
    if thinning == "voxels":
        if settings.cluster_distance_m < column_m:
            raise InputError(
                "is less than the size of the voxels, which are as wide as points are apart",
                where="pavement.cluster_distance_m",
                found=f"{settings.cluster_distance_m:g} m",
                allowed=f"at least {column_m:.3g} m with pavement.thinning: voxels",
                hint="raise it, or set pavement.thinning: columns, which raises it by itself",
            )
        return settings
    least = {
        "cluster_distance_m": 2.5 * column_m,
        "vote_radius_m": 3 * column_m,
        "outline_cell_m": column_m,
        "closing_m": 4 * column_m,
    }
    asked = {name: getattr(settings, name) for name in least}
    raised = {name: max(value, least[name]) for name, value in asked.items() if value > 0}
    return settings.model_copy(update=raised)


def outline_pavement(
    xyz_m: Floats, smooth: Bools, settings: PavementOutline, engine: Engine = OWN
) -> MultiPolygon:
    """Polygons of the connected smooth surfaces.

    Parameters
    ----------
    xyz_m : (n, 3) thinned ground points, local metres. smooth : (n,) their class.
    engine : who tells which points are connected.

    Raises
    ------
    InputError : nothing smooth, too little of it, or nothing but fragments; or the engine open3d
        cannot be loaded.
    """
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], settings.outline_cell_m)
    voted = smooth
    if settings.vote_radius_m > 0:
        voted = vote(grid, xyz_m[:, 0], xyz_m[:, 1], smooth, settings.vote_radius_m)
    if not voted.any():
        raise InputError("no pavement found: no smooth ground", hint=_HINT)
    surface = xyz_m[voted]
    cluster = euclidean_clusters(surface, settings.cluster_distance_m, engine)
    size = np.bincount(cluster)
    kept = np.flatnonzero(size >= settings.smallest_part_share * size[0])
    share = size[kept].sum() / size.sum()
    if share < 0.25:
        raise InputError(
            f"no pavement found: the smooth ground is in {len(size)} pieces",
            found=f"{share:.0%} of it in the largest {len(kept)}",
            allowed="at least 25 %",
            hint=_HINT,
        )
    polygons = []
    for part in kept:
        filled = np.zeros(grid.shape, dtype=bool)
        column, row = grid.indices(*surface[cluster == part, :2].T)
        filled[row, column] = True
        polygons.append(_polygons(grid, filled, settings))
    parts = _multi(shapely.union_all(polygons)).geoms
    outline = MultiPolygon([part for part in parts if part.area >= settings.smallest_hole_m2])
    if outline.area < _SMALLEST_AREA_M2:
        raise InputError(
            "no pavement found: too little connected smooth ground",
            found=f"{outline.area:.0f} m2",
            allowed=f"at least {_SMALLEST_AREA_M2:.0f} m2",
            hint=_HINT,
        )
    # k-means always finds a smoother half of the ground; a road is smooth on an absolute scale.
    surface = xyz_m[inside(outline, xyz_m[:, 0], xyz_m[:, 1])]
    _, neighbours = nearest_neighbours(surface, _PLANE_NEIGHBOURS)
    roughness_m = float(np.percentile(plane_residuals_m(surface, neighbours), 75))
    if roughness_m > _ROUGHEST_M:
        raise InputError(
            "no pavement found: even the smoothest connected ground is too rough for a road",
            found=f"{100 * roughness_m:.1f} cm from a local plane (75th percentile)",
            allowed=f"up to {100 * _ROUGHEST_M:.0f} cm",
            hint=_HINT,
        )
    return outline


def vote(grid: Grid, x: Floats, y: Floats, smooth: Bools, radius_m: float) -> Bools:
    """Class of each point after its neighbours' vote, which falls off as a Gaussian.

    Parameters
    ----------
    x, y : (n,) local metres; smooth : (n,) class before the vote.
    """
    sigma = radius_m / 2 / grid.cell_size_m
    cell, size = grid.flat(x, y), grid.rows * grid.columns
    total = np.bincount(cell, minlength=size).astype(float)
    yes = np.bincount(cell, weights=smooth, minlength=size)
    total, yes = (
        ndimage.gaussian_filter(part.reshape(grid.shape), sigma).ravel() for part in (total, yes)
    )
    return (yes > 0.5 * total)[cell]


# How far a road goes on beyond its kept cells. A cell is dropped when more than a fifth of it lies
# behind a kerb of 12 cm (`RoadSettings.edge_step_m`): so are four fifths of the cells at an edge,
# of which 0.4 are road on average, and of the others 0.1 are none. Of a generated highway's outline
# 87 instead of 69 % lie within 0.15 m of the true one; on five streets precision falls by 0.2 to
# 1.5 points and recall rises by 0.5 to 1.2.
_BEYOND_CELLS = 0.3


def trace_cells(grid: Grid, cells: Bools, settings: PavementOutline) -> MultiPolygon:
    """Outline of surfaces given by cells (rows, columns) of a grid, largest first; crumbs dropped.

    The grid's own cell size counts, and closings are two cells wide at least.
    """
    cell_m = grid.cell_size_m
    widths = {"outline_cell_m": cell_m, "closing_m": max(2 * cell_m, settings.closing_m)}
    own = settings.model_copy(update=widths)
    whole = _polygons(grid, cells, own).buffer(_BEYOND_CELLS * cell_m, join_style="mitre")
    parts = _multi(whole).geoms
    return MultiPolygon([part for part in parts if part.area >= settings.smallest_hole_m2])


def _polygons(grid: Grid, cells: Bools, settings: PavementOutline) -> Polygon | MultiPolygon:
    """Cells as polygons: closing, small holes filled, staircase smoothed."""
    cell = settings.outline_cell_m
    reach = max(1, round(settings.closing_m / 2 / cell)) if settings.closing_m > 0 else 0
    filled = np.pad(cells, 2 * reach)
    disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach
    filled = ndimage.binary_closing(filled, disc)
    x0, y0 = ((edge - 2 * reach) * cell for edge in (grid.west, grid.south))
    shapes = features.shapes(
        filled.astype(np.uint8), mask=filled, transform=Affine(cell, 0, x0, 0, cell, y0)
    )
    parts = shapely.union_all([shape(geometry) for geometry, _ in shapes])
    parts = without_small_holes(parts, settings.smallest_hole_m2)
    # Opening by half a road marking's gap drops whiskers; simplifying removes the raster's steps.
    opened = parts.buffer(-settings.closing_m / 2).buffer(settings.closing_m / 2)
    return opened.simplify(0.6 * cell)


def without_small_holes(parts: shapely.Geometry, smallest_m2: float) -> MultiPolygon:
    """Polygons of a geometry without holes smaller than that, largest first."""
    filled = [
        Polygon(part.exterior, [h for h in part.interiors if Polygon(h).area >= smallest_m2])
        for part in _multi(parts).geoms
    ]
    # An islet in a filled hole would overlap the filling.
    return _multi(shapely.union_all(filled))


def _multi(geometry: shapely.Geometry) -> MultiPolygon:
    """Polygons of a geometry, largest first."""
    parts = [part for part in shapely.get_parts(geometry) if isinstance(part, Polygon)]
    return MultiPolygon(sorted(parts, key=lambda part: -part.area))


# Euclidean clustering: points closer than a distance belong together (paper 1, section 2.2).


def euclidean_clusters(xyz_m: Floats, distance_m: float, engine: Engine = OWN) -> Ints:
    """Cluster number of each point, 0 for the largest cluster.

    Two points share a cluster when a chain of points links them whose steps are shorter than
    ``distance_m``. Clusters of equal size are numbered by their first point.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    engine : who links the points.

    Returns
    -------
    (n,) int64, 0 to clusters - 1.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    if len(xyz_m) == 0:
        return np.empty(0, np.int64)
    if engine == "open3d":
        return _by_size(open3d_clusters(xyz_m, distance_m))
    # An empty cell all around, so that no key beside a cell is that of a cell elsewhere.
    index = np.floor((xyz_m - xyz_m.min(axis=0)) / distance_m).astype(np.int64) + 1
    spans = index.max(axis=0) + 2
    stride = np.array([spans[1] * spans[2], spans[2], 1])
    cell = index @ stride
    order = np.argsort(cell, kind="stable")
    keys, first = np.unique(cell[order], return_index=True)
    parent = np.arange(len(xyz_m))
    points = np.ascontiguousarray(xyz_m[order], dtype=np.float64)
    _link(points, np.append(first, len(xyz_m)), keys, stride, distance_m, parent)
    roots = np.empty(len(xyz_m), np.int64)
    roots[order] = _roots(parent)
    return _by_size(roots)


def _by_size(labels: Ints) -> Ints:
    """Renumber labels so that 0 is the most frequent; ties by first appearance."""
    _, first, inverse, count = np.unique(
        labels, return_index=True, return_inverse=True, return_counts=True
    )
    rank = np.empty(len(count), np.int64)
    rank[np.lexsort((first, -count))] = np.arange(len(count))
    return rank[inverse]


@compiled()
def _link(
    xyz: Floats, first: Ints, keys: Ints, stride: Ints, distance: float, parent: Ints
) -> None:
    """Union all pairs within ``distance``; cells are as wide as it, so 27 cells hold them all."""
    for c in range(len(keys)):
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    key = keys[c] + dx * stride[0] + dy * stride[1] + dz * stride[2]
                    if key < keys[c]:
                        continue  # each pair of cells once
                    other = np.searchsorted(keys, key)
                    if other == len(keys) or keys[other] != key:
                        continue
                    for i in range(first[c], first[c + 1]):
                        root = _root(parent, i)
                        for j in range(first[other], first[other + 1]):
                            d = xyz[i] - xyz[j]
                            if d[0] ** 2 + d[1] ** 2 + d[2] ** 2 < distance**2:
                                parent[_root(parent, j)] = root


@compiled_part()
def _root(parent: Ints, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled()
def _roots(parent: Ints) -> Ints:
    return np.array([_root(parent, i) for i in range(len(parent))])
