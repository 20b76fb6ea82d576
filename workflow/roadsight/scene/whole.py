"""The scene of a cloud that is in memory as a whole: what the stages do tile by tile.

For verbs, notebooks and checks on real data, which take one cloud and keep its order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely import MultiPolygon

from roadsight.base import SEED
from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Ground, GroundClasses, GroundFilter, PavementOutline
from roadsight.scene.classes import ROADS, WATER
from roadsight.scene.grids import Grid, sample_bilinear
from roadsight.scene.pavement.choice import MOST_SHARPENED, fits_surface
from roadsight.scene.pavement.fpfh import describe_ground, fit_smoothness, is_smooth
from roadsight.scene.pavement.hidden_ground import to_what_stands
from roadsight.scene.pavement.outline import (
    inside,
    outline_pavement,
    pavement_settings_for,
    trace_cells,
)
from roadsight.scene.pavement.road_surface import (
    KnownRoad,
    RoadSettings,
    RoadSurface,
    find_road,
    road_points,
)
from roadsight.scene.profile import count_cells, density, plan_spacing_m, uses_intensity
from roadsight.scene.terrain.ground_settings import ground_settings_for
from roadsight.scene.terrain.terrain import Bounds, TerrainModel, coarse_of_tiles, label_ground

# A cloud longer or wider than this is labelled in tiles of half of it: fine pillars of more fill
# gigabytes.
_LARGEST_TILE_M = 500.0
_THINNED_M = 0.2  # Columns of which the lowest point tells the surface of a road.


def spacing_of(xyz_m: Floats) -> float:
    """Spacing of evenly spread points of the cloud's median density."""
    cells = count_cells(xyz_m, np.zeros(len(xyz_m), np.uint8))
    return plan_spacing_m(density(cells.column, cells.row, cells.count)["median"])


def ground_of(xyz_m: Floats, settings: GroundFilter | None = None) -> Bools:
    """Ground labels (n,) of a cloud, in its order.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    """
    settings = ground_settings_for(spacing_of(xyz_m), settings or GroundFilter())
    bounds = _bounds(xyz_m)
    parts = _parts(xyz_m, bounds)
    mask = np.zeros(len(xyz_m), bool)

    def tiles(halo_m: float) -> Iterator[tuple[Bounds, Floats]]:
        for core, _ in parts:
            yield core, xyz_m if len(parts) == 1 else xyz_m[_near(xyz_m, core, halo_m)]

    # Cores are yielded in the cloud's order, as `parts` holds them.
    for (_, own), (_, found) in zip(parts, label_ground(tiles, bounds, settings), strict=True):
        mask[own] = found
    return mask


def heights_of(xyz_m: Floats, ground: Bools) -> Callable[[Floats, Floats], Floats]:
    """Ground height (m) at places x, y, NaN where unknown: that of the workflow's terrain model.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. ground : (n,) ground labels.
    """
    asked = Ground()
    model = TerrainModel(_bounds(xyz_m), max(asked.dem_cell_m, spacing_of(xyz_m)))
    model.add(xyz_m[ground])
    heights = model.heights_m(asked.dem_fill_m).astype(np.float64)
    west, south, east, north = _bounds(xyz_m)

    def height(x: Floats, y: Floats) -> Floats:
        within = (x >= west) & (x <= east) & (y >= south) & (y <= north)
        return np.where(within, sample_bilinear(model.grid, heights, x, y), np.nan)

    return height


def _bounds(xyz_m: Floats) -> Bounds:
    """West, south, east, north of a half-open tile that holds all points."""
    west, south = xyz_m[:, :2].min(axis=0)
    # Half-open tiles hold their greatest coordinates only if they end beyond.
    east, north = xyz_m[:, :2].max(axis=0) + 1e-3
    return float(west), float(south), float(east), float(north)


def _parts(xyz_m: Floats, bounds_m: Bounds) -> list[tuple[Bounds, Ints | slice]]:
    """Half-open tiles with points, and which points each one holds, in their order."""
    west, south, east, north = bounds_m
    if max(east - west, north - south) <= _LARGEST_TILE_M:
        return [(bounds_m, slice(None))]
    x_edges, y_edges = _edges(west, east), _edges(south, north)
    column = np.searchsorted(x_edges, xyz_m[:, 0], "right") - 1
    row = np.searchsorted(y_edges, xyz_m[:, 1], "right") - 1
    tile = row * len(x_edges) + column
    order = np.argsort(tile, kind="stable")
    found: list[tuple[Bounds, Ints | slice]] = []
    for own in np.split(order, np.flatnonzero(np.diff(tile[order])) + 1):
        j, i = column[own[0]], row[own[0]]
        ends = float(x_edges[j + 1]), float(y_edges[i + 1])
        found.append(((float(x_edges[j]), float(y_edges[i]), *ends), own))
    return found


def _edges(first: float, last: float) -> Floats:
    """Edges of equal tiles of at most half the largest one's side."""
    return np.linspace(first, last, int(np.ceil(2 * (last - first) / _LARGEST_TILE_M)) + 1)


def _near(xyz_m: Floats, core: Bounds, halo_m: float) -> Ints:
    """Indices of the points of a tile and its halo, in their order."""
    x, y = xyz_m[:, 0], xyz_m[:, 1]
    near = (x >= core[0] - halo_m) & (x < core[2] + halo_m)
    near &= (y >= core[1] - halo_m) & (y < core[3] + halo_m)
    return np.flatnonzero(near)


def near_ground(xyz_m: Floats, settings: GroundFilter | None = None) -> Bools:
    """Points (n,) up to some decimetres from the coarse ground: a road is sought among them."""
    settings = ground_settings_for(spacing_of(xyz_m), settings or GroundFilter())
    bounds = _bounds(xyz_m)
    coarse = coarse_of_tiles(lambda _: iter([(bounds, xyz_m)]), bounds, settings)
    x, y, z = xyz_m.T
    rise = z - sample_bilinear(coarse.grid, coarse.surface_m, x, y)
    tilt = sample_bilinear(coarse.grid, coarse.slope, x, y)
    allowed = settings.coarse_tolerance_m + tilt * settings.coarse_cell_m
    return (rise > -allowed) & (rise < allowed + _lift_m(xyz_m, rise))


_LAYER_M = 0.6  # Points up to this above the coarse ground are asked for the middle of its layer.
_MOST_LIFT_M = 0.25  # Layers that are thicker are no ground (roughest_m), or low plants.
_THIN_M = 0.03  # A layer of exact scans lies so far above its lowest points.


def _lift_m(xyz_m: Floats, rise_m: Floats) -> float:
    """How much higher than in an exact cloud the layer of the ground lies above its lowest points.

    The coarse ground goes through the lowest points of cells of 1 m, some spreads below the middle
    of a noisy layer. Medians of cells are taken, and of these the lower third, by points: the rest
    is low plants.
    """
    low = np.flatnonzero(np.abs(rise_m) < _LAYER_M)
    if len(low) == 0:
        return 0.0
    cell = Grid.around(xyz_m[low, 0], xyz_m[low, 1], 1.0).flat(xyz_m[low, 0], xyz_m[low, 1])
    order = np.lexsort((rise_m[low], cell))
    _, start, count = np.unique(cell[order], return_index=True, return_counts=True)
    middle = rise_m[low][order][start + count // 2]
    ranked = np.argsort(middle)
    below = np.cumsum(count[ranked])
    typical = middle[ranked][np.searchsorted(below, below[-1] / 3)]
    return float(np.clip(typical - _THIN_M, 0.0, _MOST_LIFT_M))


@dataclass(frozen=True)
class FoundRoad:
    """Pavement of a cloud.

    Parameters
    ----------
    outline : its polygons, local metres. points : (n,) which points lie on it.
    surface_m : (k, 3) thinned ground on and around it, by which the ends of its edges are told.
    """

    outline: MultiPolygon
    points: Bools
    surface_m: Floats


NEVER_CLASSES = (7, WATER, 18)  # Low noise, water, high noise.


def road_of(
    xyz_m: Floats,
    intensity: Floats | None,
    scan: Ints | None,
    known: KnownRoad | None = None,
    settings: RoadSettings | None = None,
    classes: Bytes | None = None,
) -> tuple[FoundRoad, RoadSurface]:
    """Road as a surface that runs on until a kerb, grass or a wall ends it.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. intensity, scan : (n,) or None. known : what is known of the road.
    classes : (n,) of the file, or None: 11 and 17 are road, 7, 9 and 18 never are.

    Raises
    ------
    InputError : a seed lies off the ground, or no smooth ground is wide enough for a road.
    """
    settings, known = settings or RoadSettings(), known or KnownRoad()
    said = np.zeros(len(xyz_m), bool) if classes is None else np.isin(classes, ROADS)
    never = np.zeros(len(xyz_m), bool) if classes is None else np.isin(classes, NEVER_CLASSES)
    near = np.flatnonzero((near_ground(xyz_m) | said) & ~never)
    water = None if classes is None else xyz_m[classes == WATER, :2]
    surface = find_road(
        xyz_m[near],
        None if intensity is None else intensity[near],
        None if scan is None else scan[near],
        replace(known, road=said[near], water_xy=water),
        settings,
    )
    points = np.zeros(len(xyz_m), bool)
    points[near] = road_points(surface, xyz_m[near], settings)
    outline = trace_cells(surface.grid, surface.road | surface.bridged, PavementOutline())
    # The lowest point of each column.
    x, y, z = xyz_m[near].T
    cell = Grid.around(x, y, _THINNED_M).flat(x, y)
    order = np.lexsort((z, cell))
    _, first = np.unique(cell[order], return_index=True)
    return FoundRoad(outline, points, xyz_m[near][order[first]]), surface


# Smooth ground so far from its outline is road: on a generated highway the outline is up to 1.4 m
# too wide. The sharpened area is the same from 1 to 1.75 m: IoU 0.956 to 0.958 instead of 0.903.
_CORE_M = 1.5
# What lies farther from the smooth ground is not looked at: wider than a shoulder and a verge.
_AROUND_M = 15.0
# Share of the sharpened area on the smooth ground: a surface that runs on beyond it has leaked.
_LEAST_WITHIN = 0.9
# Share of the smooth ground that is kept: 0.93 on the highway, of which 0.93 is road.
_LEAST_KEPT = 0.7


@dataclass(frozen=True)
class Sharpened:
    """Smooth ground whose edges are those of the surface that runs on from its middle.

    Parameters
    ----------
    road, surface : what runs on. within : share of it on the smooth ground. kept : share of the
        smooth ground in it.
    """

    road: FoundRoad
    surface: RoadSurface
    within: float
    kept: float

    @property
    def agrees(self) -> bool:
        """Whether both ways found the same road, so that its edges may be trusted."""
        return self.within >= _LEAST_WITHIN and self.kept >= _LEAST_KEPT

    @property
    def weakest(self) -> tuple[float, float]:
        """The share that lies lower against its limit, and the limit."""
        held = (self.within, _LEAST_WITHIN), (self.kept, _LEAST_KEPT)
        return min(held, key=lambda pair: pair[0] / pair[1])


def sharpen(
    outline: MultiPolygon, xyz_m: Floats, intensity: Floats | None, classes: Bytes | None = None
) -> Sharpened | None:
    """Smooth ground by FPFH and k-means, its edges told by steps, tone and roughness.

    Features over many neighbours tell where a road is, but not to a decimetre where it ends.

    Parameters
    ----------
    outline : of the smooth ground. The others as in `road_of`.

    Returns
    -------
    None where the smooth ground is too narrow to be surely road in its middle, or too wide to be
    held at once.
    """
    core = shapely.buffer(outline, -_CORE_M)
    around = shapely.buffer(outline, _AROUND_M)
    west, south, east, north = around.bounds
    if core.is_empty or not fits_surface((east - west, north - south), MOST_SHARPENED):
        return None
    for area in (core, around):
        shapely.prepare(area)
    near = np.flatnonzero(shapely.contains_xy(around, xyz_m[:, 0], xyz_m[:, 1]))
    try:
        road, surface = road_of(
            xyz_m[near],
            None if intensity is None else intensity[near],
            None,
            KnownRoad(core=core),
            classes=None if classes is None else classes[near],
        )
    except InputError:
        return None
    points = np.zeros(len(xyz_m), bool)
    points[near] = road.points
    road = replace(road, points=points)
    shared = shapely.intersection(road.outline, outline).area
    areas = max(road.outline.area, 1e-9), max(outline.area, 1e-9)
    return Sharpened(road, surface, *(float(shared / area) for area in areas))


def published_road(
    xyz_m: Floats,
    ground: Bools,
    intensity: Floats,
    intensity_choice: str = GroundClasses().intensity,
    seed: int = SEED,
    engine: Engine = OWN,
) -> FoundRoad:
    """Road as the connected smooth ground by FPFH and k-means (paper 1, section 2.2).

    Thinned by columns, with the vote and the closing of the default settings, which are ours.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. ground : (n,) ground labels. intensity : (n,).
    intensity_choice : "use", "ignore" or "auto" by the spacing.
    engine : who computes normals, FPFH and clusters.

    Raises
    ------
    InputError : nothing smooth, too little of it, or nothing but fragments.
    """
    spacing_m = spacing_of(xyz_m)
    settings = GroundClasses()
    column_m = max(settings.voxel_size_m, spacing_m)
    description = describe_ground(
        xyz_m[ground], intensity[ground], column_m, settings.neighbours, engine
    )
    rng = np.random.default_rng(seed)
    count = len(description.variation)
    rows = np.sort(rng.choice(count, min(settings.sample, count), replace=False))
    use = uses_intensity(intensity_choice, spacing_m) and len(np.unique(intensity[ground])) > 1
    model = fit_smoothness(
        description.histograms[rows],
        description.variation[rows],
        description.intensity[rows] if use else None,
        settings.intensity_weight,
        seed,
        judge=intensity_choice == "auto",
    )
    smooth = is_smooth(model, description.histograms, description.variation, description.intensity)
    traced = pavement_settings_for(column_m, PavementOutline())
    outline = outline_pavement(description.xyz_m, smooth, traced, engine)
    x, y, _ = xyz_m.T
    return FoundRoad(outline, ground & inside(outline, x, y), description.xyz_m)


def settled_road(
    road: FoundRoad,
    xyz_m: Floats,
    ground: Bools,
    intensity: Floats | None,
    classes: Bytes | None = None,
) -> FoundRoad:
    """Smooth ground with its edges: those of the surface from its middle, where both ways agree.

    Else it ends where it is no longer smooth, or at what hides its edge.

    Parameters
    ----------
    road : by `published_road`. The others as it and `road_of` take them.
    """
    sharp = sharpen(road.outline, xyz_m, intensity, classes)
    if sharp is not None and sharp.agrees:
        return sharp.road
    column_m = max(GroundClasses().voxel_size_m, spacing_of(xyz_m))

    def around(bounds: Bounds) -> tuple[Floats, Bools]:
        near = _near(xyz_m, bounds, 0.0)
        return xyz_m[near], ground[near]

    hole_m2 = PavementOutline().smallest_hole_m2
    outline, _ = to_what_stands(road.outline, around, column_m, hole_m2)
    x, y, _ = xyz_m.T
    return replace(road, outline=outline, points=ground & inside(outline, x, y))
