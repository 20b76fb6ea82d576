"""The carriageway in a cloud: a smooth surface that runs on until a kerb, grass or a wall ends it.

Ground cells are joined to a seed as long as they continue its plane in height, rise, intensity and
roughness, each compared with its own spread nearby. Heights are means over many points, so that the
thickness of the layer averages out, and scans are levelled on each other first. Seeds come from
where a vehicle drove (given, or seen in the cloud as the blind disc below each scan), else from the
widest smooth ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy import ndimage
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.scene.grids import Grid, fill_gaps
from roadsight.scene.pavement.choice import FINEST_M, SURE_SCANS
from roadsight.scene.pavement.ground_raster import (
    CellMeans,
    LocalPlanes,
    cell_means,
    grow,
    local_planes,
    smooth,
    window_planes,
)
from roadsight.scene.pavement.scan_levels import close_turns, level_scans, scanner_positions


@dataclass(frozen=True)
class RoadSettings:
    """Settings of the road surface; lengths in metres.

    Parameters
    ----------
    cell_m : smallest cell; `cell_for` widens it with the spacing.
    step_m : height by which a cell may leave the plane of the surface before it.
    rise : change of slope over one cell's window that ends the surface, rise over run.
    window_m : standard deviation of the window in which the surface's plane is fitted.
    narrowest_m : narrower passages are not driven through.
    steepest : ground steeper than this, rise over run, is no road.
    gap_m : widest gap without points that the surface is carried over.
    tone_ratio, tone_spreads : change of intensity that is never an edge, as a share, and how many
        spreads of the road's own intensity are.
    rough_ratio, rough_spreads : the same for roughness.
    edge_reach_m, edge_step_m : the last cells before an edge are taken when they lie this near the
        surface's plane, in plan and in height; twice as far away where a step is seen.
    point_m, point_spreads : a point belongs to the road up to this height from its surface, or this
        many times the layer's spread.
    smallest_m2, smallest_share : separate surfaces found without a track are kept above both, the
        share of the largest one's area.
    roughest_m : a surface about which points spread more within a cell is no road. Pavement spreads
        by 0.4 to 0.7 cm in levelled scans; unlevelled ones may add 5 cm.
    """

    cell_m: float = FINEST_M
    step_m: float = 0.02
    rise: float = 0.1
    window_m: float = 1.2
    narrowest_m: float = 1.6
    steepest: float = 0.15
    gap_m: float = 6.0
    tone_ratio: float = 0.1
    tone_spreads: float = 4.0
    rough_ratio: float = 0.25
    rough_spreads: float = 4.0
    edge_reach_m: float = 0.8
    edge_step_m: float = 0.025
    point_m: float = 0.08
    point_spreads: float = 2.5
    smallest_m2: float = 100.0
    smallest_share: float = 0.2
    roughest_m: float = 0.08


@dataclass(frozen=True)
class KnownRoad:
    """What is known of the road before it is looked for; places in local metres.

    Parameters
    ----------
    track_xy : (k, 2) where a vehicle drove, in order. seeds_xy : (k, 2) places on the road.
    edges : lines that the road ends at. road : (n,) points that are said to be road.
    water_xy : (k, 2) points of water. core : area that is road by another method.
    """

    track_xy: Floats | None = None
    seeds_xy: Floats | None = None
    edges: Sequence[shapely.Geometry] = ()
    road: Bools | None = None
    water_xy: Floats | None = None
    core: shapely.Geometry | None = None


@dataclass(frozen=True)
class RoadSurface:
    """The road as cells of a grid.

    Parameters
    ----------
    grid, road : cells (rows, columns) that are road and hold or lie between points.
    bridged : cells without points that the surface was carried over.
    height_m : height of the surface. levelled_m : (n,) heights of the input's points with the
        scans' offsets removed. layer_m : spread of the points about the surface within a cell.
    level_m : largest height error of a scan that was removed. seam_m : step between the two ends of
        the scanner's turns that was removed, 0 where they close. seeded_by : what was known, of
        "seeds", "classes", "track", "core"; else "scans" or "ground". open_share : share of the
        outline that no step was seen at.
    unsure_share : area that a third more or less tolerance adds or takes, over the road's area.
    parts : connected surfaces. cell_points : median number of points in a road cell.
    """

    grid: Grid
    road: Bools
    bridged: Bools
    height_m: Floats
    levelled_m: Floats
    layer_m: float
    level_m: float
    seam_m: float
    seeded_by: str
    open_share: float
    unsure_share: float
    parts: int
    cell_points: float


@dataclass(frozen=True)
class _Ground:
    """What the growth looks at, all (rows, columns); nothing passes cells that are shut."""

    cells: CellMeans
    planes: LocalPlanes
    measured: Bools
    blank: Bools
    shut: Bools
    looks: Floats
    step_m: Floats
    bridge_m: Floats


def cell_for(xyz_m: Floats, settings: RoadSettings) -> float:
    """Cell that holds two points where points are dense, at least the smallest cell.

    The spacing is the one that a quarter of the points have or beat, so that sparse points
    elsewhere do not coarsen the road.
    """
    if len(xyz_m) == 0:
        return settings.cell_m
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], 1.0)
    cell = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    dense = float(np.percentile(np.bincount(cell)[cell], 75))
    wanted = 1.5 * dense**-0.5  # two points a cell: fewer leave every other cell empty
    return max(settings.cell_m, round(wanted / 0.05) * 0.05)


_FEWEST_POINTS = 100  # Fewer points tell no spacing.


def find_road(
    xyz_m: Floats,
    intensity: Floats | None = None,
    scan: Ints | None = None,
    known: KnownRoad | None = None,
    settings: RoadSettings | None = None,
) -> RoadSurface:
    """Road surface among points near the ground.

    Parameters
    ----------
    xyz_m : (n, 3) points up to some decimetres from the ground, local metres.
    intensity : (n,) or None. scan : (n,) number of the scan or strip, or None.
    known : what is known of the road.

    Raises
    ------
    InputError : too few points, a seed without ground, or no smooth ground that is wide enough for
        a road.
    """
    settings, known = settings or RoadSettings(), known or KnownRoad()
    if len(xyz_m) < _FEWEST_POINTS:
        raise InputError(
            "too little ground for a road",
            found=f"{len(xyz_m)} points",
            allowed=f"at least {_FEWEST_POINTS}",
        )
    scan = np.zeros(len(xyz_m), np.int64) if scan is None else scan
    places_m, sure = np.empty((0, 2)), np.empty(0, bool)  # where scanners stood, in order
    if len(np.unique(scan)) > 1:
        places_m, sure = scanner_positions(xyz_m, scan)
    closed_m, seam_m = close_turns(xyz_m, scan, places_m, sure)
    levelled, shifts = level_scans(np.column_stack([xyz_m[:, :2], closed_m]), scan)
    points = np.column_stack([xyz_m[:, :2], levelled])
    tones = np.zeros(len(points)) if intensity is None else intensity.astype(np.float64)
    driven = places_m[sure] if sure.size and sure.mean() >= SURE_SCANS else np.empty((0, 2))
    cell_m = cell_for(_around(xyz_m, driven, known), settings)
    ground = _bounded(_describe(points, tones, cell_m, settings), known)
    seeds, seeded_by = _seeds(ground, xyz_m, driven, known, settings)
    grown = _grow_all(ground, seeds, seeded_by, settings)
    if not grown.any():
        raise InputError("no road found: no smooth ground wide enough", hint="give a track")
    road, height = _to_the_edge(ground, grown & ground.measured, settings)
    if not seeds.any():  # repeated from the surface far from its edge
        depth = ndimage.distance_transform_edt(grown)
        seeds = depth >= 0.6 * depth.max()
    more, less = (_grow_from(ground, grown & seeds, settings, factor) for factor in (1.3, 0.7))
    inside = ground.cells.count[road]
    layer_m = _layer_m(ground.cells, road)
    if layer_m > settings.roughest_m:
        raise InputError(
            "no road found: even the smoothest surface is too rough for one",
            found=f"points spread by {100 * layer_m:.0f} cm about it",
            allowed=f"up to {100 * settings.roughest_m:.0f} cm",
            hint="give a track, or the pavement as a polygon (placement.tma)",
        )
    holes = ndimage.binary_fill_holes(road) & ~road
    return RoadSurface(
        grid=ground.cells.grid,
        road=road,
        bridged=grown & ground.blank & holes,
        height_m=height,
        levelled_m=levelled,
        layer_m=layer_m,
        level_m=float(np.abs(shifts[:, 0]).max()) if len(shifts) else 0.0,
        seam_m=seam_m,
        seeded_by=seeded_by,
        open_share=_open_share(ground, road, settings),
        unsure_share=float((more ^ less)[ground.measured].sum() / max(int(road.sum()), 1)),
        parts=int(ndimage.label(road | grown)[1]),
        cell_points=float(np.median(inside[inside > 0])) if (inside > 0).any() else 0.0,
    )


def _layer_m(cells: CellMeans, road: Bools) -> float:
    """Typical spread of the points of a road cell; of three points at least."""
    spread = cells.variance_m2[road & (cells.count >= 3)]
    return float(np.sqrt(np.median(spread))) if spread.size else 0.0


def road_points(surface: RoadSurface, xyz_m: Floats, settings: RoadSettings) -> Bools:
    """Which of the points (n, 3) given to `find_road` lie on its surface."""
    cell = surface.grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    allowed = max(settings.point_m, settings.point_spreads * surface.layer_m)
    off = np.abs(surface.levelled_m - surface.height_m.ravel()[cell])
    return surface.road.ravel()[cell] & (off < allowed)


SCALES_CELLS = (1.5, 2.5, 4.0, 6.5, 10.0)  # Each 1.6 times the last; 0.3 to 2 m at the finest cell.
_NEAR_M = 0.6  # A cell this near to a point is measured if its plane is known.
_STEP_WINDOW_M = 3.0  # The slope of the street around a kerb: the median of a lane's width.


def _describe(points: Floats, tones: Floats, cell_m: float, settings: RoadSettings) -> _Ground:
    cells = cell_means(points, tones, cell_m)
    # Half a centimetre: a quarter of the step that counts, so that chance steps are four spreads.
    planes = local_planes(cells, SCALES_CELLS, error_m=settings.step_m / 4)
    occupied = cells.count > 0
    near = ndimage.distance_transform_edt(~occupied) * cell_m <= max(_NEAR_M, 1.5 * cell_m)
    step = step_heights_m(planes, cell_m)
    measured = planes.known & near
    # A cell without ground that is fit for a road is an obstacle, not a gap to be bridged.
    away = ndimage.distance_transform_edt(~measured) * cell_m
    blank = ~measured & (away <= settings.gap_m / 2)
    # Looks are logarithms: of the intensity, and of the residual about the local planes.
    there = planes.known.astype(np.float64)
    square = ndimage.uniform_filter(np.where(planes.known, planes.residual_m**2, 0.0), 5)
    square /= np.maximum(ndimage.uniform_filter(there, 5), 1e-6)
    # A tenth of a millimetre: below it a surface is as flat as any.
    rough = np.where(planes.known, 0.5 * np.log(np.maximum(square, 0.0) + 1e-8), np.nan)
    looks = np.stack([_tone(cells), rough], axis=-1)
    depth = ndimage.distance_transform_edt(blank) * cell_m
    wide = ndimage.maximum_filter(depth, size=2 * round(1.0 / cell_m) + 1)
    # Along a gap the crossfall changes by about 1 %; the gap is twice as wide as it is deep.
    bridge = 0.01 * 2 * wide
    measured = measured & (np.hypot(planes.east, planes.north) < settings.steepest)
    return _Ground(cells, planes, measured, blank, np.zeros_like(blank), looks, step, bridge)


def _tone(cells: CellMeans) -> Floats:
    """Logarithm of the intensity without thin bright marks; NaN where unknown or all alike.

    Of the smoothed intensity around a cell the lower third is taken: paint is bright and narrow.
    """
    occupied = cells.count > 0
    typical = float(np.median(cells.intensity[occupied]))
    if typical <= 0.0 or np.ptp(cells.intensity[occupied]) == 0.0:
        return np.full(cells.count.shape, np.nan)
    weight = cells.weight
    total = smooth(weight, 1.5)
    value = smooth(weight * _log_tone(cells), 1.5)
    known = total > 0.3
    tone = np.where(known, value / np.maximum(total, 1e-9), np.nan)
    lower = ndimage.percentile_filter(fill_gaps(tone), 35, size=5, mode="nearest")
    return np.where(known, lower, np.nan)


def step_heights_m(planes: LocalPlanes, cell_m: float) -> Floats:
    """Height of the step in each window: slope beyond the street's, over the blurred step's width.

    A step of height h seen through a Gaussian of width s has slope h / (s sqrt(2 pi)).
    """
    size = 2 * round(_STEP_WINDOW_M / 2 / cell_m) + 1
    parts = []
    for slope in (planes.east, planes.north):
        filled = fill_gaps(np.where(planes.known, slope, np.nan))
        parts.append(slope - ndimage.median_filter(filled, size=size, mode="nearest"))
    return np.hypot(*parts) * planes.scale_m * np.sqrt(2 * np.pi)


_MOST_ROUNDS = 5  # What was shut may have hidden another way round: a street needs two rounds.


def _grow_from(ground: _Ground, seed: Bools, settings: RoadSettings, factor: float = 1.0) -> Bools:
    """Surface of the seeds, without what only a gap joins to it though a step parts them elsewhere.

    Where a kerb runs through a gap, such as the blind disc below a scanner, the surface is carried
    over it. Beside the gap the step is seen.
    """
    for _ in range(_MOST_ROUNDS):
        grown = _grow_once(ground, seed, settings, factor)
        if not (grown & ground.blank).any():
            break
        bare = replace(ground, blank=np.zeros_like(ground.blank))
        parted = _parted(ground, grown, _grow_once(bare, seed, settings, factor), settings)
        if not parted.any():
            break
        ground = replace(ground, measured=ground.measured & ~parted)
    return grown


_PARTED_M = 2.0  # Growth ends up to 1 m before a step from either side.
_LEAST_PARTED_M = 3.0  # Shorter stretches beside a surface are corners of a gap.


def _parted(ground: _Ground, grown: Bools, joined: Bools, settings: RoadSettings) -> Bools:
    """Parts (rows, columns) of a surface that only gaps join to what is ``joined`` without any.

    Such a part lies beside it over a step, or across measured ground that did not join, along more
    cells than it lies across gaps.
    """
    part, parts = ndimage.label(grown & ground.measured & ~joined)
    if not parts:
        return np.zeros_like(grown)
    cell_m = ground.cells.grid.cell_size_m
    reach = round(_PARTED_M / cell_m)
    # Right beside it the surface was free to go on without a gap, and a step ended it.
    beside = ndimage.binary_dilation(joined) & _step_seen(ground, settings)
    across = _rim(joined, ground.measured & ~grown, reach)
    over_gaps = _rim(joined, ground.blank, reach) & ~beside
    seen, hidden = (np.bincount(part[rim], None, parts + 1) for rim in (across, over_gaps))
    parted = (seen >= _LEAST_PARTED_M / cell_m) & (seen > hidden)
    parted[0] = False
    return np.asarray(parted[part], bool)


def _rim(core: Bools, way: Bools, cells: int) -> Bools:
    """Cells beside those that are reached from a core over so many cells of a way."""
    reached = ndimage.binary_dilation(core, iterations=cells, mask=way | core)
    return np.asarray(ndimage.binary_dilation(reached), bool)


# Times the seeds' spread that counts at most. Windows make a ramp of an edge, whose spread would
# allow the next step up it: from 3 on, a dark street leaks over verges three times as bright. F1 of
# five streets was 92.2 (lowest 78) with 2 and 92.6 (80) without a limit; at 5 cm of noise 90.7 and
# 88.6.
_MOST_SPREAD = 2.0


def _grow_once(ground: _Ground, seed: Bools, settings: RoadSettings, factor: float) -> Bools:
    cell_m, planes = ground.cells.grid.cell_size_m, ground.planes
    seed = seed & ground.measured
    step, sigma = factor * settings.step_m, max(settings.window_m / cell_m, 3.0)
    # A height that is itself unsure may be off by two of its errors, but never by half a kerb.
    allowed = np.minimum(np.hypot(step, 2 * planes.error_m), 1.5 * step)
    # Spread of each look about its mean in the growth's window, in nine tenths of the seeds.
    usual = []
    for look in np.moveaxis(ground.looks, -1, 0):
        known = seed & np.isfinite(look)
        _, variance = _local_spread(look, known, sigma)
        usual.append(np.sqrt(np.percentile(variance[known], 90)) if known.any() else np.inf)
    return grow(
        seed,
        ground.measured | ground.blank,
        ground.blank,
        planes.height_m,
        planes.east * cell_m,
        planes.north * cell_m,
        ground.looks,
        np.array([settings.tone_spreads, settings.rough_spreads]),
        np.array([settings.tone_ratio, settings.rough_ratio]),
        _MOST_SPREAD * np.array(usual),
        allowed,
        ground.bridge_m,
        settings.rise * cell_m,
        sigma,
        max(2, round(0.6 / cell_m)),
        max(1, round(settings.narrowest_m / 2 / cell_m)),
        0.3,
    )


_MOST_PARTS = 50  # Surfaces tried; a site of some hectares has a dozen.


def _grow_all(ground: _Ground, seeds: Bools, seeded_by: str, settings: RoadSettings) -> Bools:
    """Surface of the seeds; without a track, surfaces from ever smaller seeds as well."""
    if seeded_by != "ground":
        return _grow_from(ground, seeds, settings)
    cell_m = ground.cells.grid.cell_size_m
    area = cell_m**2
    # Ground that is flat over a lane's half width or more.
    flat = ground.measured & (ground.step_m < 0.6 * settings.step_m)
    free = opened(flat, max(1.0, 1.0 / cell_m)) & flat
    total = np.zeros_like(free)
    largest = 0.0
    for _ in range(_MOST_PARTS):
        number, _ = ndimage.label(free)
        large = np.bincount(number.ravel()) >= settings.smallest_m2 / 4 / area
        large[0] = False
        free = large[number]
        seed = _widest(ground, free, settings)
        if not seed.any():
            break
        part = _grow_from(ground, seed, settings)
        size = float((part & ground.measured).sum() * area)
        if size >= max(settings.smallest_m2, settings.smallest_share * largest):
            total |= part
            largest = max(largest, size)
        free &= ~ndimage.binary_dilation(part | seed, iterations=2)
    return total


def opened(area: Bools, radius: float) -> Bools:
    """Opening of a raster by a disc of a radius in cells."""
    core = ndimage.distance_transform_edt(np.pad(area, 1))[1:-1, 1:-1] > radius
    if not core.any():
        return np.zeros_like(area)
    return ndimage.distance_transform_edt(~core) <= radius


def _widest(ground: _Ground, free: Bools, settings: RoadSettings) -> Bools:
    """Disc of 1 m where free ground is widest and holds most points."""
    cell_m = ground.cells.grid.cell_size_m
    width = np.minimum(ndimage.distance_transform_edt(free) * cell_m, 3.0)
    density = ndimage.gaussian_filter(np.where(free, ground.cells.count, 0.0), 2.0 / cell_m)
    score = np.where(free & (width >= 0.5), width * np.sqrt(density), 0.0)
    seed = np.zeros_like(free)
    if score.max() > 0.0:
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        reach = max(1, round(1.0 / cell_m))
        rows = slice(max(0, row - reach), row + reach + 1)
        columns = slice(max(0, column - reach), column + reach + 1)
        seed[rows, columns] = free[rows, columns]
    return seed


_WATER_M = 2.0  # Water reflects few pulses: gaps this near to its points are water.


def _bounded(ground: _Ground, known: KnownRoad) -> _Ground:
    """Ground without the cells at known edges and of water, which is no gap to be bridged."""
    shut = np.zeros_like(ground.measured)
    grid = ground.cells.grid
    if known.water_xy is not None and len(known.water_xy):
        shut.ravel()[grid.flat(*known.water_xy.T)] = True
        away = ndimage.distance_transform_edt(~shut) * grid.cell_size_m
        shut |= ground.blank & (away <= _WATER_M)
    for line in known.edges:
        length = float(shapely.length(line))
        steps = np.arange(0.0, length + grid.cell_size_m, grid.cell_size_m / 2)
        xy = shapely.get_coordinates(shapely.line_interpolate_point(line, steps))
        column, row = (xy / grid.cell_size_m - (grid.west, grid.south)).T.astype(int)
        within = (column >= 0) & (row >= 0) & (column < grid.columns) & (row < grid.rows)
        shut[row[within], column[within]] = True
    if not shut.any():
        return ground
    return replace(ground, measured=ground.measured & ~shut, blank=ground.blank & ~shut, shut=shut)


# Points this near to what is known of the road tell its spacing: four lanes and their sides.
_ROADSIDE_M = 25.0


def _around(xyz_m: Floats, driven: Floats, known: KnownRoad) -> Floats:
    """Points near what is known of the road; all of them where nothing is, or few are near.

    Their spacing is the road's, whatever else the cloud holds.
    """
    given = [xy for xy in (driven, known.seeds_xy, known.track_xy) if xy is not None and len(xy)]
    if not given:
        return xyz_m
    away, _ = cKDTree(np.concatenate(given)[:, :2]).query(
        xyz_m[:, :2], distance_upper_bound=_ROADSIDE_M
    )
    near = np.isfinite(away)
    return xyz_m[near] if near.sum() >= _FEWEST_POINTS else xyz_m


def _seeds(
    ground: _Ground, xyz_m: Floats, driven: Floats, known: KnownRoad, settings: RoadSettings
) -> tuple[Bools, str]:
    """Cells from which the road grows, and what they are known by."""
    flat = ground.measured & (ground.cells.count > 0) & (ground.step_m < settings.step_m)
    found: dict[str, Bools] = {}
    if known.seeds_xy is not None and len(known.seeds_xy):
        found["seeds"] = _at_seeds(ground, known.seeds_xy)
    if known.road is not None and known.road.any():
        # Cells most of whose points are said to be road.
        grid = ground.cells.grid
        cell = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
        said = np.bincount(cell, known.road, minlength=grid.rows * grid.columns).reshape(grid.shape)
        mostly = ndimage.binary_closing(said > ground.cells.count / 2)
        found["classes"] = opened(mostly, 2.0) & flat
    if known.track_xy is not None and len(known.track_xy):
        found["track"] = _along_track(ground, flat, known.track_xy)
    if known.core is not None:
        row, column = np.nonzero(flat)
        within = shapely.contains_xy(known.core, *ground.cells.grid.centres(column, row))
        found["core"] = np.zeros_like(flat)
        found["core"][row[within], column[within]] = True
    found = {name: seed for name, seed in found.items() if seed.any()}
    if found:
        return np.logical_or.reduce(list(found.values())), ", ".join(found)
    if len(driven):
        seed = _along_track(ground, flat, _with_direction(ground, flat, driven))
        if seed.any():
            return seed, "scans"
    return np.zeros_like(flat), "ground"


_HALF_LANE_M = 1.75  # Half a lane beside the driven line is lane.
_STANDING_M = 3.0  # Positions are up to 0.7 m off, so that a shorter drive has no direction.
# Flat ground so far to both sides tells a street's direction; walks beside it are not met.
_LOOK_M = 15.0
_SIDE_M = 2.0  # The line of a vehicle that stood reaches to a lane's length beyond its blind disc.


def _with_direction(ground: _Ground, flat: Bools, places: Floats) -> Floats:
    """Positions (k, 2) of scans in order; of a vehicle that stood, a line along its street.

    The street runs where flat ground goes on for longest to both sides.
    """
    apart = places[:, None] - places[None]
    if np.hypot(*apart.transpose(2, 0, 1)).max() >= _STANDING_M:
        return places
    middle = np.median(places, axis=0)
    row, column = np.nonzero(flat & (ground.cells.count > 0))
    off = np.column_stack(ground.cells.grid.centres(column, row)) - middle
    off = off[np.hypot(*off.T) < _LOOK_M]
    angles = np.linspace(0, np.pi, 36, endpoint=False)
    along = np.column_stack([np.cos(angles), np.sin(angles)])
    inside = np.abs(off @ np.column_stack([-along[:, 1], along[:, 0]]).T) < _HALF_LANE_M
    ahead = off @ along.T > 0
    both = np.minimum((inside & ahead).sum(axis=0), (inside & ~ahead).sum(axis=0))
    best = along[int(np.argmax(both))]
    return np.array([middle - _SIDE_M * best, middle + _SIDE_M * best])


_SEED_M = 1.0  # Ground this near to a seed is where the road is looked for first.
_SEED_OFF_M = 3.0  # A seed farther from any ground lies off the cloud or in an obstacle.


def _at_seeds(ground: _Ground, seeds_xy: Floats) -> Bools:
    """Measured ground around places (k, 2), or an `InputError` where one of them has none."""
    row, column = np.nonzero(ground.measured)
    tree = cKDTree(np.column_stack(ground.cells.grid.centres(column, row)))
    off_m, _ = tree.query(seeds_xy)
    if (off_m > _SEED_OFF_M).any():
        worst = int(np.argmax(off_m))
        raise InputError(
            f"seed {worst + 1} of {len(seeds_xy)} lies where no ground was measured",
            found=f"{off_m[worst]:.1f} m from the nearest",
            allowed=f"up to {_SEED_OFF_M:g} m",
            hint="give x, y on the road in the cloud's own coordinates",
        )
    seed = np.zeros_like(ground.measured)
    for place, off in zip(seeds_xy, off_m, strict=True):
        near = tree.query_ball_point(place, max(_SEED_M, off + 1e-6))
        seed[row[near], column[near]] = True
    return seed


def _along_track(ground: _Ground, flat: Bools, track_xy: Floats) -> Bools:
    """Flat ground of the lane that a vehicle drove in."""
    line = driven_line(track_xy[:, :2])
    row, column = np.nonzero(flat)
    x, y = ground.cells.grid.centres(column, row)
    near = shapely.dwithin(line, shapely.points(x, y), _HALF_LANE_M)
    seed = np.zeros_like(flat)
    seed[row[near], column[near]] = True
    return opened(ndimage.binary_closing(seed), 2.0) & ground.measured


def driven_line(xy_m: Floats) -> shapely.Geometry:
    """Line through positions (n, 2), in order, straight on for some metres at both ends."""
    return shapely.linestrings(np.vstack([_before(xy_m), xy_m, _before(xy_m[::-1])]))


# To which the direction of a drive is asked: 0.2 m where its line ends. By four positions, each up
# to 0.65 m off, it was up to 13 degrees off (four streets in five directions), and the line crossed
# a kerb; now up to 4.
_DIRECTION_DEG = 2.0
_DIRECTION_M = 10.0  # More of a drive is a bend rather than a direction.
_FEWEST_POSITIONS = 3  # Two positions tell no scatter.
_LEAST_SCATTER_M = 0.02  # Of positions by survey receivers.
_MOVED_M = 0.1  # Positions whose first and last are nearer to each other tell no direction.
_AHEAD_M = 5.0  # The road goes on beyond the first and last position by more than a blind disc.


def _before(xy_m: Floats) -> Floats:
    """Place (2,) on the way to the first of the positions (n, 2), straight on.

    The direction is that of a line fitted to as many of the first positions as tell it by their
    scatter: few of an exact track, which may bend. Itself where they come back or do not move.
    """
    away_m = np.hypot(*(xy_m - xy_m[0]).T)
    near = slice(_first(away_m >= _DIRECTION_M))
    count = np.arange(1, len(xy_m[near]) + 1)
    # Scatter about a smooth drive: second differences of independent errors spread by the root of
    # six of them, and have a median length of 1.18 of that; a corner of the drive is an outlier.
    bend_m = np.hypot(*np.diff(xy_m[near], 2, axis=0).T)
    spread_m = float(np.median(bend_m)) / (1.18 * np.sqrt(6)) if bend_m.size else 0.0
    off_m = float(np.hypot(spread_m, _LEAST_SCATTER_M)) * np.sqrt(12 / count)
    told = (off_m <= np.radians(_DIRECTION_DEG) * away_m[near]) & (count >= _FEWEST_POSITIONS)
    used = xy_m[: _first(told)]
    along = np.linalg.svd(used - used.mean(axis=0), full_matrices=False)[2][0]
    moved_m = float((used[0] - used[-1]) @ along)
    return xy_m[0] + (_AHEAD_M * np.sign(moved_m) * along if abs(moved_m) > _MOVED_M else 0.0)


def _first(fit: Bools) -> int:
    """Number of positions up to the first that is fit; all of them where none is."""
    return int(np.argmax(fit)) + 1 if fit.any() else len(fit)


# Points whose mean, at 1 cm of noise, is off by a fifth of the step that an edge may have.
_OWN_POINTS = 4
# The growth looks at tones through windows, of which the lower third counts, and so may run on by
# three cells where bright ground begins: on a street of 8 m without kerbs it is 0.45 m too wide on
# either side without this rim, 0 to 0.07 m with it.
_RIM_M = 0.6


def _to_the_edge(ground: _Ground, road: Bools, settings: RoadSettings) -> tuple[Bools, Floats]:
    """The road with the cells up to its edge, and the height of its surface.

    Windows blur a step, so that the growth stops before it; the surface is carried on from the road
    alone, and a cell belongs while its own mean lies on it.
    """
    cells, cell_m = ground.cells, ground.cells.grid.cell_size_m
    weight = np.where(road, cells.weight, 0.0)
    sigma = max(1.0 / cell_m, 3.0)
    height, _, _, _, total, _ = window_planes(weight, cells.height_m, cells.across, cells.up, sigma)
    away = ndimage.distance_transform_edt(~road) * cell_m
    near = (away <= max(settings.edge_reach_m, 1.5 * cell_m)) & (total > 0.05)
    # Growth ended where windows began to see a step: up to 1 m before a kerb of 12 cm.
    near |= (away <= 2 * settings.edge_reach_m) & (total > 0.05) & _step_seen(ground, settings)
    # So many points that their mean is off by a fifth of the step; one alone may be a stray.
    fewest = np.clip((5 * _layer_m(cells, road) / settings.edge_step_m) ** 2, 2, _OWN_POINTS)
    # Beside a wall the window's plane is lifted by it, but not the cell's own mean.
    own = (cells.count >= fewest) & (np.abs(cells.height_m - height) < settings.edge_step_m)
    near &= (
        ground.measured & (np.abs(ground.planes.height_m - height) < settings.edge_step_m)
    ) | own
    near = ndimage.binary_propagation(road, mask=(road | near) & ~ground.shut)
    whole = opened(near, 2.0) | road
    inner = ndimage.distance_transform_edt(road) * cell_m > _RIM_M
    toned = whole & (inner | _as_toned(ground, inner, settings))
    # Paint is not the edge: a cell of another tone between two of the road's stays.
    return opened(ndimage.binary_closing(toned) & whole, 2.0) | (inner & whole), height


def _as_toned(ground: _Ground, road: Bools, settings: RoadSettings) -> Bools:
    """Cells whose own tone is that of the road beside them, or that hold no point."""
    cells, looks = ground.cells, ground.looks[..., 0]
    occupied, known = cells.count > 0, road & np.isfinite(looks)
    if not known.any():
        return np.ones(road.shape, bool)
    tone = np.where(occupied, _log_tone(cells), 0.0)
    sigma = max(1.0 / cells.grid.cell_size_m, 3.0)
    mean, variance = _local_spread(looks, known, sigma)
    allowed = settings.tone_spreads * np.hypot(np.sqrt(variance), settings.tone_ratio)
    return (np.abs(tone - mean) < allowed) | ~occupied


def _local_spread(look: Floats, known: Bools, sigma: float) -> tuple[Floats, Floats]:
    """Mean and variance of a look where it is known, in a Gaussian window of ``sigma`` cells."""
    total = np.maximum(smooth(known.astype(np.float64), sigma), 1e-9)
    value = np.where(known, look, 0.0)
    mean = smooth(value, sigma) / total
    return mean, np.maximum(smooth(value**2, sigma) / total - mean**2, 0.0)


def _log_tone(cells: CellMeans) -> Floats:
    """Logarithm of the intensity; a tenth of the typical one keeps the darkest from blowing up."""
    return np.log(cells.intensity + 0.1 * float(np.median(cells.intensity[cells.count > 0])))


def _open_share(ground: _Ground, road: Bools, settings: RoadSettings) -> float:
    """Share of the outline's cells next to which no step was seen within half a metre."""
    cell_m = ground.cells.grid.cell_size_m
    rim = road & ~ndimage.binary_erosion(road)
    if not rim.any():
        return 1.0
    size = 2 * max(1, round(0.5 / cell_m)) + 1
    seen = ndimage.maximum_filter(_step_seen(ground, settings) & ground.measured, size=size)
    return float(1.0 - seen[rim].mean())


def _step_seen(ground: _Ground, settings: RoadSettings) -> Bools:
    """Cells (rows, columns) whose window holds a step that may end the road."""
    return np.asarray(ground.step_m >= 1.5 * settings.step_m)
