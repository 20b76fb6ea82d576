"""Road edges of the LiDAR as short straight pieces, and those that one camera may see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment.track import sides_of_track

_USUAL = Reach()
# Edge points that are fitted at once, each with up to 64 neighbours: bounds the memory
_BATCH = 20_000
_PLAN_M, _HEIGHT_M = 2.5, 20.0  # How far neighbours are used for place and for height
_FEWEST_ACROSS = 10  # Points that either side needs for the road to have a width


@dataclass(frozen=True)
class RoadEdges:
    """Edge points of a site, freed of the raster's steps.

    Attributes
    ----------
    xyz_m : (n, 3) local metres, each moved onto the line through its neighbours.
    along : (n, 3) vectors along the edge, of length 1 in plan, either way.
    tree : of the points in plan.
    """

    xyz_m: Floats
    along: Floats
    tree: cKDTree | None

    @classmethod
    def from_points(cls, xyz_m: ArrayLike) -> RoadEdges:
        """Fit a line in plan and a parabola in height around each edge point.

        A raster of 1 ft places each point up to half a cell wrong in plan and in height, which
        is 60 pixels at 12 m for a lens of 20 degrees.

        Parameters
        ----------
        xyz_m : (n, 3) edge pixels, local metres.

        Raises
        ------
        InputError : a coordinate is not finite.
        """
        xyz = np.asarray(xyz_m, np.float64).reshape(-1, 3)
        if not np.isfinite(xyz).all():
            raise InputError("a road edge point is not finite", where="road edges")
        if not len(xyz):
            return cls(xyz, xyz.copy(), None)
        tree = cKDTree(xyz[:, :2])
        # For heights the mean point of each square metre in plan is enough.
        cell = np.floor(xyz[:, :2] - xyz[:, :2].min(axis=0)).astype(np.int64)
        number = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
        _, index, count = np.unique(number, return_inverse=True, return_counts=True)
        low = xyz.min(axis=0)
        sums = [np.bincount(index, column) for column in (xyz - low).T]
        coarse = np.column_stack(sums) / count[:, None] + low
        coarse_tree = cKDTree(coarse[:, :2])
        moved, along = np.empty_like(xyz), np.empty_like(xyz)
        for first in range(0, len(xyz), _BATCH):
            part = slice(first, first + _BATCH)
            xy, direction = _on_line(tree, xyz, xyz[part])
            z, slope = _heights(coarse_tree, coarse, xy, direction, xyz[part, 2])
            moved[part] = np.column_stack([xy, z])
            along[part] = np.column_stack([direction, slope])
        return cls(moved, along, cKDTree(moved[:, :2]))

    def near(self, xy_m: ArrayLike, radius_m: float) -> Ints:
        """Numbers of the points within a radius in plan, ascending."""
        if self.tree is None:
            return np.empty(0, np.int64)
        return np.array(sorted(self.tree.query_ball_point(np.asarray(xy_m)[:2], radius_m)), int)


@dataclass(frozen=True)
class NearEdges:
    """Road edges that one camera may see, each side by itself.

    Attributes
    ----------
    xyz_m, along, inward : (n, 3); ``inward`` is a level unit vector towards the track.
    half_m : (n,) half of the length that a point stands for.
    left : how many of them come first and lie left of the track.
    """

    xyz_m: Floats
    along: Floats
    inward: Floats
    half_m: Floats
    left: int

    @property
    def half_width_m(self) -> float:
        """Half the usual distance between both sides; infinity where one has too few points."""
        left, right = self.xyz_m[: self.left, :2], self.xyz_m[self.left :, :2]
        if min(len(left), len(right)) < _FEWEST_ACROSS:
            return float("inf")
        return 0.5 * float(np.median(cKDTree(right).query(left)[0]))

    def thinned(self, step: int) -> NearEdges:
        """Every ``step``-th point of each side, which then stands for as many."""
        number = np.arange(len(self.half_m))
        kept = np.flatnonzero(np.where(number < self.left, number, number - self.left) % step == 0)
        left = int(np.count_nonzero(kept < self.left))
        parts = self.xyz_m[kept], self.along[kept], self.inward[kept], step * self.half_m[kept]
        return NearEdges(*parts, left)


def edges_ahead(
    edges: RoadEdges,
    place_xyz_m: ArrayLike,
    heading_deg: float,
    track_xy_m: ArrayLike,
    *,
    nearest_m: float = _USUAL.nearest_m,
    farthest_m: float = _USUAL.farthest_m,
    points: int = _USUAL.edge_points,
    visible: Bools | None = None,
) -> NearEdges:
    """Road edges in front of a place, thinned so that near and far both count.

    Parameters
    ----------
    place_xyz_m : where the camera is about, local metres.
    track_xy_m : (m, 2) the track around it, which decides the sides.
    nearest_m, farthest_m : range in plan. points : how many to keep at most.
    visible : (len(edges),) what the terrain does not hide; all if None.
    """
    place = np.asarray(place_xyz_m, np.float64)
    index = edges.near(place, farthest_m)
    if visible is not None:
        index = index[visible[index]]
    offset = edges.xyz_m[index] - place
    gap_m = np.hypot(offset[:, 0], offset[:, 1])
    turn = wrap_deg(np.degrees(np.arctan2(offset[:, 0], offset[:, 1])) - heading_deg)
    ahead = (gap_m >= nearest_m) & (np.abs(turn) < 90.0)
    index, gap_m = index[ahead], gap_m[ahead]
    side = sides_of_track(edges.xyz_m[index], track_xy_m)
    parts, halves = [], []
    for value in (-1, 1):
        own = np.flatnonzero(side == value)
        own = own[np.lexsort((own, gap_m[own]))]
        kept, half_m = _thinned(gap_m[own], points // 2)
        parts.append(index[own[kept]])
        halves.append(half_m)
    chosen = np.concatenate(parts)
    sides = np.repeat([-1.0, 1.0], [len(p) for p in parts])
    xyz, along = edges.xyz_m[chosen], edges.along[chosen]
    # Level unit vectors across the edge, towards the track.
    inward = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
    if len(xyz):
        track = np.asarray(track_xy_m, np.float64)
        steps = np.diff(track, axis=0)
        _, nearest = cKDTree(0.5 * (track[:-1] + track[1:])).query(xyz[:, :2])
        right = np.column_stack([steps[nearest, 1], -steps[nearest, 0]])
        turned = np.einsum("ni,ni->n", inward[:, :2], right) * -sides < 0
        inward = np.where(turned[:, None], -inward, inward)
    return NearEdges(xyz, along, inward, np.concatenate(halves), len(parts[0]))


def _thinned(gap_m: Floats, points: int) -> tuple[Ints, Floats]:
    """Which of the points, sorted by range, to keep: evenly in the logarithm of the range."""
    if not len(gap_m):
        return np.empty(0, np.int64), np.empty(0)
    weight = 1.0 / gap_m
    share = np.full(len(gap_m), 1.0)
    for _ in range(4):  # Shares above one are cut and the rest is raised to match.
        free = share < 1.0 if share.min() < 1.0 else np.ones(len(share), bool)
        rest = max(points - (len(share) - int(free.sum())), 0)
        share[free] = np.minimum(1.0, rest * weight[free] / weight[free].sum())
    # Just below whole numbers, so that rounding of the sum decides nothing.
    turn = np.floor(np.cumsum(share) - 1e-9)
    kept = np.flatnonzero(np.diff(turn, prepend=-1.0) > 0)
    # Half a foot for each point of the raster that one stands for, and a foot of overlap.
    return kept, 0.3 + 0.15 / share[kept]


def _on_line(tree: cKDTree, xyz: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Places on the lines through the neighbours and directions of these, both (n, 2)."""
    offset, used = _neighbours(tree, xyz, centre[:, :2], 32, _PLAN_M)
    offset = offset[..., :2]
    weight = used / used.sum(axis=1, keepdims=True)
    mean = np.einsum("nk,nki->ni", weight, offset)
    apart = (offset - mean[:, None]) * used[..., None]
    spread = np.einsum("nki,nkj->nij", apart, apart)
    direction = np.linalg.eigh(spread)[1][:, :, 1]
    foot = mean - np.einsum("ni,ni->n", mean, direction)[:, None] * direction
    return centre[:, :2] + foot, direction


def _heights(
    tree: cKDTree, xyz: Floats, centre_xy: Floats, direction: Floats, z_m: Floats
) -> tuple[Floats, Floats]:
    """Height and slope at places of parabolas along the edge, (n,) each."""
    offset, used = _neighbours(tree, xyz, centre_xy, 64, _HEIGHT_M)
    station = np.einsum("nki,ni->nk", offset[..., :2], direction)
    aside = offset[..., 0] * direction[:, None, 1] - offset[..., 1] * direction[:, None, 0]
    # A bend of 40 m radius stays within; the far side of the road has its own height.
    used &= np.abs(aside) <= 0.8 + station**2 / 80.0
    z = np.where(used, offset[..., 2] - z_m[:, None], 0.0)
    share = np.abs(station) / _HEIGHT_M
    weight = np.where(used, (1.0 - np.minimum(share, 1.0) ** 3) ** 3, 0.0)
    terms = np.stack([np.ones_like(station), station, station**2], axis=-1)
    square = np.einsum("nk,nki,nkj->nij", weight, terms, terms)
    right = np.einsum("nk,nki,nk->ni", weight, terms, z)
    # As if it were known that slopes are below some 10 % and bends of the grade small; a lone
    # point keeps its height.
    square += np.diag([1e-6, 1e-2 / 0.1**2, 1e-2 / 1e-3**2])
    level, slope, _ = np.linalg.solve(square, right[..., None])[..., 0].T
    return z_m + level, slope


def _neighbours(
    tree: cKDTree, xyz: Floats, centre_xy: Floats, count: int, radius_m: float
) -> tuple[Floats, Bools]:
    """Offsets (n, k, 3) to neighbours in plan (heights as they are), and which of them count."""
    count = min(count, len(xyz))
    gap, index = tree.query(centre_xy, k=[*range(1, count + 1)], distance_upper_bound=radius_m)
    used = np.isfinite(gap)
    found = xyz[np.where(used, index, 0)]
    found[..., :2] -= centre_xy[:, None]
    return found, used
