"""What limits the worth of a pavement: what it is measured on, and what of the site it reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from scipy import ndimage
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.doubts import Doubt
from roadsight.scene.classes import ROADS, WATER
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.ground_raster import cell_means, local_planes
from roadsight.scene.pavement.road_surface import (
    SCALES_CELLS,
    RoadSettings,
    cell_for,
    step_heights_m,
)

# Ground, model key points, rails, road, bridge deck: what a pavement's points may be called.
_GROUND_CLASSES = (2, 8, 10, 11, 17)
_UNTOLD = (0, 1, 12)  # Never classified, unclassified, overlap: classes that say nothing.
_MOST_WATER = 0.05  # Share of water among a pavement's points: a shore in the outline, not a sea.
_SEA = 0.5  # Mostly water is no pavement at all.
# Share of points that the file calls neither ground nor road: parked cars and low plants stay under
# a fifth of real streets.
_MOST_OTHER = 0.3
_LEAST_OWN = 0.7  # Share of the file's own road points on the pavement.


# Scans that say different things of one surface: other epochs, or registration that failed.


# Cells in which scans are compared: several points of each, and little rise of the road within.
_CELL_M = 0.5
_FEWEST_POINTS = 3  # Points of a scan in a cell whose mean height counts.


@dataclass
class ScanHeights:
    """Heights of scans on the cells that they share, gathered tile by tile.

    Parameters
    ----------
    scan, off_m : of each scan in each shared cell: its number, its mean height above the middle of
        the scans there. cell : number of the cell. spread_m : of the points of one scan in a cell.
    """

    scan: list[Ints] = field(default_factory=list)
    off_m: list[Floats] = field(default_factory=list)
    cell: list[Ints] = field(default_factory=list)
    spread_m: list[Floats] = field(default_factory=list)
    cells: int = 0

    def add(self, xyz_m: Floats, scan: Ints) -> None:
        """Compare scans on a surface.

        Parameters
        ----------
        xyz_m : (n, 3) points of whole cells of the surface. scan : (n,) their scans.
        """
        if len(xyz_m) == 0:
            return
        place = np.floor(xyz_m[:, :2] / _CELL_M).astype(np.int64)
        keys = np.column_stack([place, scan])
        order = np.lexsort(keys.T)
        keys, height_m = keys[order], xyz_m[order, 2]
        first = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(axis=1)])
        count = np.diff(np.append(first, len(keys)))
        mean = np.add.reduceat(height_m, first) / count
        square = np.add.reduceat((height_m - np.repeat(mean, count)) ** 2, first) / count
        enough = count >= _FEWEST_POINTS
        _, cell = np.unique(keys[first][enough, :2], axis=0, return_inverse=True)
        cell, mean = cell.ravel(), mean[enough]
        shared = np.bincount(cell)[cell] > 1
        cell, mean, owner = cell[shared], mean[shared], keys[first][enough][shared, 2]
        if len(cell):  # heights above the median of their cell
            order = np.lexsort((mean, cell))
            _, first, count = np.unique(cell[order], return_index=True, return_counts=True)
            ranked = mean[order]
            middle = (ranked[first + (count - 1) // 2] + ranked[first + count // 2]) / 2
            mean = mean - middle[np.unique(cell, return_inverse=True)[1]]
        self.off_m.append(mean)
        self.scan.append(owner)
        self.cell.append(cell + self.cells)
        self.spread_m.append(np.sqrt(square[enough][shared]))
        self.cells += int(cell.max()) + 1 if len(cell) else 0


_REACH_BLOCK_M = 20.0  # Blocks in which the dense corridor is looked at: wider than its road.
# A block is dense from this share of the density that a quarter of the points have or beat.
_DENSE = 0.25
_STRIP_M = 0.5  # An edge is confirmed by a step within this distance.
_STEP_M = 0.03  # Lowest kerb.


@dataclass
class PavementFacts:
    """What is measured of a pavement, tile by tile or at once.

    Parameters
    ----------
    on, told, water, other : points on it, those of a telling class, of water, of no ground.
    own, own_on : points that the file calls road, and those of them on the pavement.
    variances_m2 : of heights within cells, of each part that was added. open_m, outline_m : length
        of the outline without a step, and in all. blocks : points of ground by block of 20 m.
    scans : heights of scans beside each other.
    """

    on: int = 0
    told: int = 0
    water: int = 0
    other: int = 0
    own: int = 0
    own_on: int = 0
    variances_m2: list[Floats] = field(default_factory=list)
    open_m: float = 0.0
    outline_m: float = 0.0
    blocks: dict[tuple[int, int], int] = field(default_factory=dict)
    scans: ScanHeights = field(default_factory=ScanHeights)

    def add_points(
        self,
        xyz_m: Floats,
        classes: Bytes | None,
        ground: Bools,
        on: Bools,
        scan: Ints | None = None,
    ) -> None:
        """Count points (n, 3) of a part of the cloud.

        Parameters
        ----------
        classes : (n,) of the file, or None. ground : (n,) labels. on : (n,) inside the outline.
        scan : (n,) numbers of their scans, or None.
        """
        if scan is not None:
            self.scans.add(xyz_m[on & ground], scan[on & ground])
        x, y = xyz_m[ground, 0], xyz_m[ground, 1]
        grid = Grid.around(x, y, _REACH_BLOCK_M)
        numbers = grid.flat(x, y)
        counts = np.bincount(numbers, minlength=grid.rows * grid.columns).reshape(grid.shape).T
        for column, row in np.argwhere(counts):
            key = grid.west + int(column), grid.south + int(row)
            self.blocks[key] = self.blocks.get(key, 0) + int(counts[column, row])
        self.on += int((on & ground).sum())
        if classes is None:
            return
        said = classes[on & (ground | (classes == WATER))]
        self.told += int((~np.isin(said, _UNTOLD)).sum())
        self.water += int((said == WATER).sum())
        self.other += int((~np.isin(said, (*_UNTOLD, *_GROUND_CLASSES, WATER))).sum())
        own = np.isin(classes, ROADS)
        self.own += int(own.sum())
        self.own_on += int((own & on).sum())

    def add_rim(self, ground_m: Floats, outline: MultiPolygon, core: Sequence[float]) -> None:
        """Look for steps along the outline in a tile, and at the layer on the pavement.

        Parameters
        ----------
        ground_m : (n, 3) ground points of the tile and a halo of some metres. core : west, south,
            east, north of the tile.
        """
        if len(ground_m) < 100:
            return
        rim = shapely.intersection(outline.boundary, shapely.box(*core))
        if rim.is_empty:
            return
        cell_m = cell_for(ground_m, RoadSettings())
        cells = cell_means(ground_m, np.zeros(len(ground_m)), cell_m)
        planes = local_planes(cells, SCALES_CELLS, error_m=_STEP_M / 6)
        step = np.where(planes.known, step_heights_m(planes, cell_m), 0.0)
        size = 2 * max(1, round(_STRIP_M / cell_m)) + 1
        seen = ndimage.maximum_filter(step, size=size) >= _STEP_M
        for line in shapely.get_parts(rim):
            if line.length == 0:
                continue
            steps = np.arange(cell_m / 2, line.length, cell_m)
            xy = shapely.get_coordinates(shapely.line_interpolate_point(line, steps))
            column, row = cells.grid.indices(xy[:, 0], xy[:, 1])
            if len(xy):
                self.outline_m += line.length
                self.open_m += line.length * float(1.0 - seen[row, column].mean())
        row, column = np.nonzero(cells.count >= 3)
        x, y = cells.grid.centres(column, row)
        shapely.prepare(outline)
        inner = shapely.contains_xy(outline, x, y)
        self.variances_m2.append(cells.variance_m2[row, column][inner])

    @property
    def layer_m(self) -> float:
        """Typical spread of the points of a cell on the pavement; NaN where too few share one."""
        every = np.concatenate(self.variances_m2) if self.variances_m2 else np.empty(0)
        return float(np.sqrt(np.median(every))) if len(every) >= 100 else float("nan")

    def reached(self, outline: MultiPolygon) -> float:
        """Share of the dense blocks of 20 m that hold pavement, or have some beside them."""
        places = np.array(list(self.blocks))
        count = np.array(list(self.blocks.values()))
        order = np.argsort(-count)
        typical = count[order][np.searchsorted(np.cumsum(count[order]), 0.25 * count.sum())]
        dense = places[count >= _DENSE * typical] * _REACH_BLOCK_M
        boxes = shapely.box(*dense.T, *(dense + _REACH_BLOCK_M).T)
        return float(shapely.dwithin(boxes, outline, _REACH_BLOCK_M / 2).mean())


# Share of the outline that no step confirms; 0.26 to 0.43 on five streets with kerbs.
_MOST_OPEN = 0.5
# Area that hangs on the tolerance, over the pavement's: 0.2 to 0.5 on four streets with F1 of 94
# and more, 1.4 on one with 80.
_MOST_UNSURE = 1.0
LEAST_PER_M2 = 9.0  # Points that a target half a metre wide needs: 1.5 spacings across it.
# Share of the dense blocks that the pavement comes to; a drive's own road comes to nearly all.
_LEAST_REACHED = 0.5
# Share of the track on the pavement: positions are a metre off, junctions are closed late.
_LEAST_TRACK = 0.8
_MAIN_PART = 0.5  # Share of the area in the largest of several surfaces.
# Thickness of the layer (one sigma) up to which a method was held to a small loss: five labelled
# streets lose under 3 points of F1 from one of 0, 1, 2, 3 cm to the next as one surface, and 3.5
# from 0 to 1 cm by FPFH on ten neighbours, on which a sharpened one rests.
MOST_LAYER_M = {"surface": 0.03, "published": 0.01, "sharpened": 0.01}


def pavement_doubts(
    outline: MultiPolygon,
    method: str,
    facts: PavementFacts,
    layer_m: float,
    open_share: float,
    track_xy: Floats | None = None,
    unsure_share: float = float("nan"),
) -> list[Doubt]:
    """Notes and doubts about a pavement, or a refusal.

    Parameters
    ----------
    method : "surface", "published", "sharpened" or "user". layer_m : thickness (one sigma) that the
        method met, NaN where unknown. open_share : of the outline, NaN where unknown.
    track_xy : (k, 2). unsure_share : of the area, that hangs on the tolerance, NaN where unknown.
    """
    parts = [part.area for part in outline.geoms]
    main = max(parts) / sum(parts)
    text = f"the pavement is in {len(parts)} surfaces; share of the largest"
    if main < _MAIN_PART:
        text = f"the pavement is in {len(parts)} fragments, none of which is most of it; largest"
    held = _held("pavement_parts", text, main, _MAIN_PART, least=True)
    if len(parts) == 1:
        text = "the pavement is one surface, m2"
        held = Doubt("pavement_parts", "note", text, round(parts[0]))
    found = [*_of_classes(facts, method), held, *epoch_doubts(facts.scans)]
    reached = facts.reached(outline) if facts.blocks else 1.0
    text = "share of the densely scanned area that the pavement comes to"
    if reached < _LEAST_REACHED:
        text = "the pavement comes to only a part of the densely scanned area: look what it misses"
    found.append(_held("pavement_reach", text, reached, _LEAST_REACHED, least=True))
    if track_xy is not None and len(track_xy) > 1:
        line = shapely.linestrings(track_xy)
        share = float(shapely.intersection(line, outline).length / max(line.length, 1e-9))
        text = "share of the track on the pavement"
        if share < _LEAST_TRACK:
            text = "the pavement covers only a part of the track that was driven"
        found.append(_held("pavement_track", text, share, _LEAST_TRACK, least=True))
    if method in MOST_LAYER_M and layer_m > MOST_LAYER_M[method]:
        text = (
            "heights on the pavement scatter by more than its method was tested with (are the scans"
            " registered well?), one sigma in m"
        )
        limit = MOST_LAYER_M[method]
        found.append(Doubt("pavement_layer", "doubt", text, round(layer_m, 4), limit))
    if method in MOST_LAYER_M and not np.isnan(open_share):
        text = "share of the outline at which no step was seen"
        if open_share > _MOST_OPEN:
            text = "the outline is uncertain along this share of its length: no step shows there"
        found.append(_held("pavement_open", text, open_share, _MOST_OPEN, least=False))
    if not np.isnan(unsure_share):
        text = "area that a third more or less tolerance adds or takes, over the pavement's"
        if unsure_share > _MOST_UNSURE:
            text = "the pavement hangs on its tolerance: share that a third of it adds or takes"
        found.append(_held("pavement_unsure", text, unsure_share, _MOST_UNSURE, least=False))
    per_m2 = facts.on / max(sum(parts), 1e-9)
    text = "points a square metre of pavement"
    if per_m2 < LEAST_PER_M2:
        text = "the pavement has fewer points a square metre than targets need"
    found.append(_held("pavement_density", text, per_m2, LEAST_PER_M2, least=True, digits=1))
    return found


def _held(
    code: str, text: str, value: float, limit: float, *, least: bool, digits: int = 3
) -> Doubt:
    """A note, or a doubt where a value lies beyond its limit."""
    beyond = value < limit if least else value > limit
    return Doubt(code, "doubt" if beyond else "note", text, round(value, digits), limit)


def _of_classes(facts: PavementFacts, method: str) -> list[Doubt]:
    """What the file's classes say of the pavement; nothing where it has none."""
    found = []
    if facts.told:
        water, other = facts.water / facts.told, facts.other / facts.told
        if water > _SEA and method != "user":
            text = (
                "what was taken for pavement is mostly water: give the site an extent, or the"
                " pavement as a polygon (placement.tma)"
            )
            found.append(Doubt("pavement_water", "refused", text, round(water, 3), _SEA))
        elif water > _MOST_WATER:
            text = "the file calls this share of the pavement's points water"
            found.append(Doubt("pavement_water", "doubt", text, round(water, 3), _MOST_WATER))
        if other > _MOST_OTHER:
            text = "the file calls this share of the pavement's points neither ground nor road"
            found.append(Doubt("pavement_classes", "doubt", text, round(other, 3), _MOST_OTHER))
    if facts.own:
        share = facts.own_on / facts.own
        text = "share of the file's own road points on the pavement"
        if share < _LEAST_OWN:
            text = "much of what the file calls road is not on the pavement"
        found.append(_held("pavement_own_road", text, share, _LEAST_OWN, least=True))
    return found


_FEWEST_CELLS = 100  # Cells, 25 m2, that a scan must share with others before it is compared.
# Scans differ by over 5 cm on 2 to 16 % of the pavement of five streets, where a turn tilted them,
# and by over this on up to 2 %. Thinner layers of asphalt are not told from registration.
_LEAST_APART_M = 0.1
# Means of three points differ by so many spreads of one point by chance once in 10^6 cells.
_SPREADS = 4.0
# Share of cells on which scans differ: parked cars that left, and edges of kerbs.
_MOST_CHANGED = 0.05


def epoch_doubts(heights: ScanHeights) -> list[Doubt]:
    """Doubts about a pavement whose scans differ by more than their noise; none where they agree.

    A scan that lies off as a whole is said by its offset, and what is left by the share of cells.
    """
    if not heights.off_m or sum(map(len, heights.off_m)) == 0:
        return []
    scan, off_m = np.concatenate(heights.scan), np.concatenate(heights.off_m)
    cell, spread_m = np.concatenate(heights.cell), np.concatenate(heights.spread_m)
    apart_m = max(_LEAST_APART_M, _SPREADS * float(np.median(spread_m)))
    ids, number, count = np.unique(scan, return_inverse=True, return_counts=True)
    order = np.lexsort((off_m, number))
    _, first = np.unique(number[order], return_index=True)
    middle = off_m[order][first + count // 2]
    middle[count < _FEWEST_CELLS] = 0.0
    found = []
    if np.ptp(middle) > apart_m:
        high, low = ids[np.argmax(middle)], ids[np.argmin(middle)]
        text = (
            f"scan {high} lies above scan {low} on the pavement (point_source_id), m: other epochs"
            " or registration; give the cloud of one epoch"
        )
        gap_m = round(float(np.ptp(middle)), 3)
        found.append(Doubt("pavement_scans_apart", "doubt", text, gap_m, round(apart_m, 3)))
    left = off_m - middle[number]
    order = np.argsort(cell, kind="stable")
    _, first = np.unique(cell[order], return_index=True)
    highest = np.maximum.reduceat(left[order], first)
    lowest = np.minimum.reduceat(left[order], first)
    changed = float((highest - lowest > apart_m).mean())
    if len(first) >= _FEWEST_CELLS and changed > _MOST_CHANGED:
        text = (
            f"share of the pavement on which scans differ by over {100 * apart_m:.0f} cm in height:"
            " other epochs? give the cloud of one"
        )
        found.append(Doubt("pavement_epochs", "doubt", text, round(changed, 3), _MOST_CHANGED))
    return found
