"""Where beams return, by a vote of the samples around them (paper 1, Eq. 4, made robust).

The published way averages the ranges of the points nearest to a beam in angle. Ours lets them vote:
each says at what range the beam meets the plane on which it lies (its own range, where it lies on
none), and the beam returns from the first layer that stops it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats, Floats32, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.scene.samples import Samples

_COLUMNS = 12  # of a row of a view: see `_seen_from`
_VIEW_SIZE = 1  # samples of this size show how spacing grows with range
_VIEW_SAMPLES = 20_000  # so many of them: a median over some thousand a band is good to a per cent
_VIEW_FROM_M = 2.0  # from this range on: nearer, a vehicle hides the ground
_VIEW_BAND = 1.5  # bands of range end at so many times where they begin
_VIEW_LEAST = 50  # samples of a band that has a median
_BLOCK_RADIUS_M = 6.0  # no sample of a block of 6.4 m lies farther than this from its centre
_BLOCK_NEAR_M = 3.0  # half a block: its nearest samples decide the size that it is taken in


@dataclass(frozen=True)
class VoteSettings:
    """How samples vote.

    Parameters
    ----------
    voters : samples that vote on a beam, about; the cone that holds them is as wide as it must be.
    fewer_m : beyond this range, their number falls as 1 / range: a cone of one angle would hold
        surfaces that lie apart. Measured on frames of five streets; 15 to 30 m do as well.
    bucket_rad : samples are kept in buckets of about this size, where the search begins.
    widest_rad : no sample farther than this from a beam votes.
    layer_m : ranges within twice this belong to one layer.
    beam_m : samples on a beam's axis count double against passing by, those at this distance once.
    axis_m : beyond this range none counts double: farther samples stand for voxels wider than
        `beam_m`, so that nobody knows which of their points lie on the axis. Measured like
        `fewer_m`; 10 to 15 m do as well.
    trusted_m : planes that leave the range at which they are met more uncertain are not used.
    reach : planes are used up to so many standard deviations of their points from the sample.
    sample_rad : samples are taken in the size that is seen under about this angle.
    touch : a layer stops no beam that passes it by more than so many spacings of its points.
    own_view : samples vote where their spacing grows with at least this power of the range from the
        sensor: 1 where the cloud was scanned from its place, 0 where from all along the road.
    agreeing : a surfel is believed where at least so many samples around are of its layer, and none
        is of another.
    """

    voters: int = 20
    fewer_m: float = 20.0
    bucket_rad: float = 0.0026
    widest_rad: float = 0.0175
    layer_m: float = 0.5
    beam_m: float = 0.03
    axis_m: float = 13.0
    trusted_m: float = 0.5
    reach: float = 6.0
    sample_rad: float = 0.0035
    touch: float = 1.0
    own_view: float = 0.33
    agreeing: int = 4


class View:
    """Samples as seen from one place.

    Parameters
    ----------
    samples : of the scene. origin_m : (3,) local metres. max_range_m : samples beyond have no vote.
    """

    def __init__(
        self,
        samples: Samples,
        origin_m: NDArray[np.floating],
        max_range_m: float,
        settings: VoteSettings,
    ) -> None:
        self._settings, s = settings, samples
        # Rows of the blocks in range, each in the size that its range calls for.
        away_m = np.linalg.norm(s.block_m - np.asarray(origin_m, np.float64), axis=1)
        reached = np.flatnonzero(away_m - _BLOCK_RADIUS_M <= max_range_m)
        wanted = np.maximum(away_m[reached] - _BLOCK_NEAR_M, s.edge_m)
        wanted = wanted * settings.sample_rad / s.edge_m
        size = np.clip(np.floor(np.log2(wanted)), 0, len(s.starts) - 1).astype(np.int64)
        bucket_rad = settings.bucket_rad
        self._buckets = int(np.ceil(4 / bucket_rad)), int(np.ceil(2 / bucket_rad))
        self._seen, self._starts, self._least, self._most = _seen_from(
            s.xyz_m,
            s.points,
            s.normal,
            s.offset_m,
            s.spread_m,
            s.reach_m,
            s.spacing_m,
            s.starts[size, reached],
            s.starts[size, reached + 1],
            np.asarray(origin_m, np.float64),
            max_range_m,
            *self._buckets,
        )

    def ranges(self, directions: Floats32, first_m: Floats32) -> Floats32:
        """Ranges (n,) at which beams return; infinite for none.

        Parameters
        ----------
        directions : (n, 3) unit vectors. first_m : (n,) ranges of the first surfels, infinite for
            none; they stand where the samples around agree, and where none votes.
        """
        s = self._settings
        return _vote(
            directions,
            first_m,
            self._seen,
            self._starts,
            self._least,
            self._most,
            *self._buckets,
            s.voters,
            s.fewer_m,
            s.bucket_rad,
            s.widest_rad,
            s.layer_m,
            s.beam_m,
            s.axis_m,
            s.trusted_m,
            s.reach,
            s.touch,
            s.agreeing,
        )


def seen_from_here(
    samples: Samples, origin_m: NDArray[np.floating], max_range_m: float, settings: VoteSettings
) -> bool:
    """Whether samples lie as if the cloud had been scanned from about this place.

    Only then are the points behind a layer evidence that beams passed it, and their number beside
    that of the layer's points the share that did: elsewhere they were seen past its sides. Seen
    from its scanner, the spacing of a cloud's points grows with range; from elsewhere it does not.
    """
    size = min(_VIEW_SIZE, len(samples.starts) - 1)
    begin, end = samples.starts[size, 0], samples.starts[size, -1]
    rows = slice(begin, end, max((end - begin) // _VIEW_SAMPLES, 1))
    range_m = np.linalg.norm(samples.xyz_m[rows] - np.asarray(origin_m), axis=1)
    known = np.isfinite(samples.spread_m[rows]) & (range_m > _VIEW_FROM_M) & (range_m < max_range_m)
    if not known.any():
        return False
    band = np.floor(np.log(range_m[known] / _VIEW_FROM_M) / np.log(_VIEW_BAND)).astype(np.int64)
    spacing_m = samples.spacing_m[rows][known] - samples.edge_m * 2**size / 2
    log_m = np.log([range_m[known], np.maximum(spacing_m, samples.edge_m / 10)])
    enough = np.flatnonzero(np.bincount(band) >= _VIEW_LEAST)
    if len(enough) < 3:
        return False
    middle = np.array([np.median(log_m[:, band == number], axis=1) for number in enough])
    away = middle[:, 0] - middle[:, 0].mean()
    return bool((away * middle[:, 1]).sum() >= settings.own_view * (away**2).sum())


@compiled()
def _seen_from(
    xyz_m: Floats32,
    points: Floats32,
    normal: Floats32,
    offset_m: Floats32,
    spread_m: Floats32,
    reach_m: Floats32,
    spacing_m: Floats32,
    begin: Ints,
    end: Ints,
    origin_m: Floats,
    max_range_m: float,
    columns: int,
    rows: int,
) -> tuple[Floats32, Ints32, Floats32, Floats32]:
    """Samples sorted by bucket, with what a vote needs.

    Returns
    -------
    seen : (m, 12) direction (3), range, normal (3), distance of the plane from the origin along it,
        spread, reach, spacing, points. starts : first row of each bucket.
    least, most : ranges in each bucket.
    """
    total = np.int64(0)
    for block in range(len(begin)):
        total += end[block] - begin[block]
    key = np.empty(total, np.int32)
    starts = np.zeros(columns * rows + 1, np.int32)
    n = 0
    for block in range(len(begin)):
        for i in range(begin[block], end[block]):
            x, y, z = (
                xyz_m[i, 0] - origin_m[0],
                xyz_m[i, 1] - origin_m[1],
                xyz_m[i, 2] - origin_m[2],
            )
            r = np.sqrt(x * x + y * y + z * z)
            key[n] = -1
            if 0 < r < max_range_m:
                column, row = _bucket(x / r, y / r, z / r, columns, rows)
                key[n] = min(int(row), rows - 1) * columns + min(int(column), columns - 1)
                starts[key[n] + 1] += 1
            n += 1
    for k in range(columns * rows):
        starts[k + 1] += starts[k]
    seen = np.empty((starts[-1], _COLUMNS), np.float32)
    fill = starts[:-1].copy()
    least = np.full(columns * rows, np.inf, np.float32)
    most = np.zeros(columns * rows, np.float32)
    n = 0
    for block in range(len(begin)):
        for i in range(begin[block], end[block]):
            if key[n] >= 0:
                row = seen[fill[key[n]]]
                fill[key[n]] += 1
                x, y, z = (
                    xyz_m[i, 0] - origin_m[0],
                    xyz_m[i, 1] - origin_m[1],
                    xyz_m[i, 2] - origin_m[2],
                )
                r = np.sqrt(x * x + y * y + z * z)
                row[0], row[1], row[2], row[3] = x / r, y / r, z / r, r
                row[4], row[5], row[6] = normal[i, 0], normal[i, 1], normal[i, 2]
                row[7] = normal[i, 0] * x + normal[i, 1] * y + normal[i, 2] * z + offset_m[i]
                row[8], row[9], row[10] = spread_m[i], reach_m[i], spacing_m[i]
                row[11] = points[i]
                least[key[n]] = min(least[key[n]], r)
                most[key[n]] = max(most[key[n]], r)
            n += 1
    return seen, starts, least, most


@compiled()
def _vote(
    directions: Floats32,
    first_m: Floats32,
    seen: Floats32,
    starts: Ints32,
    least: Floats32,
    most: Floats32,
    columns: int,
    rows: int,
    voters: int,
    fewer_m: float,
    bucket_rad: float,
    widest_rad: float,
    layer_m: float,
    beam_m: float,
    axis_m: float,
    trusted_m: float,
    reach: float,
    touch: float,
    agreeing: int,
) -> Floats32:
    out = first_m.copy()
    room = 4 * voters
    found, gap2 = np.empty(room, np.int64), np.empty(room)
    t, weight, stops, near = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    for beam in range(len(directions)):
        d = directions[beam]
        if first_m[beam] < np.inf:
            box = _box(d, columns, rows, bucket_rad)
            if _agree(starts, least, most, columns, box, first_m[beam], layer_m, agreeing):
                continue
        radius = _cone(d, starts, columns, rows, voters, bucket_rad, widest_rad)
        if radius == 0:
            continue
        n = _gather(d, seen, starts, columns, rows, radius, found, gap2)
        if 2 * n < voters and radius < widest_rad:
            radius = min(2 * radius, widest_rad)
            n = _gather(d, seen, starts, columns, rows, radius, found, gap2)
        n, radius = _narrower(seen, found, gap2, n, radius, fewer_m)
        for k in range(n):
            row = seen[found[k]]
            met = _met_at(row, d, trusted_m, reach)
            gap_m2 = gap2[k] * row[3] * row[3]
            kernel = (1 - gap2[k] / (radius * radius)) * row[11]
            place = k
            while place > 0 and t[place - 1] > met:
                t[place], weight[place] = t[place - 1], weight[place - 1]
                stops[place], near[place] = stops[place - 1], near[place - 1]
                place -= 1
            t[place], weight[place] = met, kernel
            on_axis = max(1 - gap_m2 / beam_m**2, 0.0) if row[3] < axis_m else 0.0
            stops[place] = kernel * (1 + on_axis)
            near[place] = gap_m2 - (touch * row[10]) ** 2
        voted_m = _first_layer(t, weight, stops, near, n, layer_m)
        if voted_m < np.inf:
            out[beam] = voted_m
    return out


@compiled()
def _bucket(x: float, y: float, z: float, columns: int, rows: int) -> tuple[float, float]:
    """Place of a unit vector on the grid of buckets: pseudo-angle and sine of the elevation.

    The pseudo-angle (0 to 4 around) grows at most as fast as the azimuth, and needs no arctangent.
    """
    flat = abs(x) + abs(y)
    turn = y / flat if flat > 0 else 0.0
    if x < 0:
        turn = 2 - turn
    elif y < 0:
        turn = 4 + turn
    return turn * columns / 4, (z + 1) * rows / 2


@compiled()
def _box(d: Floats32, columns: int, rows: int, radius: float) -> tuple[int, int, int, int]:
    """Buckets that hold all within an angle of a direction: rows, and columns to be wrapped."""
    column, row = _bucket(d[0], d[1], d[2], columns, rows)
    flat = np.sqrt(max(1 - d[2] * d[2], 0.0))
    low = max(int(row - radius * rows / 2), 0)
    high = min(int(row + radius * rows / 2), rows - 1)
    wide = radius / max(flat - radius, 1e-6) * columns / 4
    if 2 * wide >= columns - 1:
        return low, high, 0, columns - 1
    return low, high, int(np.floor(column - wide)), int(np.floor(column + wide))


@compiled()
def _count(starts: Ints32, columns: int, low: int, high: int, first: int, last: int) -> int:
    """Samples in a box of buckets, from the first rows of buckets alone."""
    total = 0
    for i in range(low, high + 1):
        base = i * columns
        if first < 0:
            total += starts[base + columns] - starts[base + columns + first]
            total += starts[base + last + 1] - starts[base]
        elif last >= columns:
            total += starts[base + columns] - starts[base + first]
            total += starts[base + last - columns + 1] - starts[base]
        else:
            total += starts[base + last + 1] - starts[base + first]
    return total


@compiled()
def _agree(
    starts: Ints32,
    least: Floats32,
    most: Floats32,
    columns: int,
    box: tuple[int, int, int, int],
    range_m: float,
    layer_m: float,
    agreeing: int,
) -> bool:
    """Whether a box of buckets holds enough samples, all of them about as far as a range."""
    low, high, first, last = box
    total = 0
    for i in range(low, high + 1):
        for j in range(first, last + 1):
            at = i * columns + j % columns
            if starts[at + 1] > starts[at]:
                if least[at] < range_m - layer_m or most[at] > range_m + layer_m:
                    return False
                total += starts[at + 1] - starts[at]
    return total >= agreeing


@compiled()
def _gather(
    d: Floats32,
    seen: Floats32,
    starts: Ints32,
    columns: int,
    rows: int,
    radius: float,
    found: Ints,
    gap2: Floats,
) -> int:
    """Samples within a radius of a direction and their squared gaps, as many as there is room."""
    low, high, first, last = _box(d, columns, rows, radius)
    n, limit = 0, radius * radius
    for i in range(low, high + 1):
        for j in range(first, last + 1):
            at = i * columns + j % columns
            for k in range(starts[at], starts[at + 1]):
                dx, dy, dz = seen[k, 0] - d[0], seen[k, 1] - d[1], seen[k, 2] - d[2]
                gap = dx * dx + dy * dy + dz * dz
                if gap < limit and n < len(found):
                    found[n], gap2[n] = k, gap
                    n += 1
    return n


@compiled()
def _narrower(
    seen: Floats32, found: Ints, gap2: Floats, n: int, radius: float, fewer_m: float
) -> tuple[int, float]:
    """Number of gathered samples in a cone that is narrower far away, put first, and its radius.

    The range is that of the sample nearest to the beam in angle. A cone that would be empty stays.
    """
    if n == 0:
        return n, radius
    range_m = seen[found[gap2[:n].argmin()], 3]
    if range_m <= fewer_m:
        return n, radius
    narrow = radius * np.sqrt(fewer_m / range_m)
    kept = 0
    for k in range(n):
        if gap2[k] < narrow * narrow:
            found[kept], gap2[kept] = found[k], gap2[k]
            kept += 1
    return (kept, narrow) if kept else (n, radius)


@compiled_part()
def _met_at(row: Floats32, d: Floats32, trusted_m: float, reach: float) -> float:
    """Range at which a beam meets a sample's plane, or the sample's own."""
    r = row[3]
    across = row[4] * d[0] + row[5] * d[1] + row[6] * d[2]
    if not abs(across) * trusted_m > row[8]:
        return r
    t = row[7] / across
    dx, dy, dz = d[0] * t - row[0] * r, d[1] * t - row[1] * r, d[2] * t - row[2] * r
    if t > 0 and dx * dx + dy * dy + dz * dz <= (reach * row[9]) ** 2:
        return t
    return r


@compiled()
def _cone(
    d: Floats32,
    starts: Ints32,
    columns: int,
    rows: int,
    voters: int,
    start_rad: float,
    most_rad: float,
) -> float:
    """Radius of the cone that holds about as many samples as shall vote, 0 if there are none."""
    half = start_rad
    while True:
        low, high, first, last = _box(d, columns, rows, half)
        count = _count(starts, columns, low, high, first, last)
        if count >= voters or half >= most_rad:
            break
        half = min(2 * half, most_rad)
    if count == 0:
        return 0.0
    return float(half * min(np.sqrt(4 / np.pi * voters / count) * 1.25, 1.0))


@compiled()
def _first_layer(  # noqa: PLR0912
    t: Floats, weight: Floats, stops: Floats, near: Floats, n: int, layer_m: float
) -> float:
    """Middle of the first layer that stops the beam as well as the strongest one supports it."""
    best, total, end, last = 0.0, 0.0, 0, -1
    for i in range(n):
        while end < n and t[end] <= t[i] + 2 * layer_m:
            total += weight[end]
            if near[end] <= 0:
                last = end
            end += 1
        if last >= i and total > best:
            best = total
        total -= weight[i]
    if best == 0:
        return np.inf
    answer, support, limit = np.inf, -1.0, np.inf
    for i in range(n):
        if t[i] > limit:
            break
        total, stop, middle, touches = 0.0, 0.0, 0.0, False
        for j in range(i, n):
            if t[j] > t[i] + 2 * layer_m:
                break
            total += weight[j]
            stop += stops[j]
            middle += weight[j] * t[j]
            touches |= near[j] <= 0
        if not touches:
            continue
        if limit == np.inf:
            if stop < best * (1 - 1e-9):
                continue
            limit = t[i] + layer_m
        if total > support:
            support, answer = total, middle / total
    return answer
