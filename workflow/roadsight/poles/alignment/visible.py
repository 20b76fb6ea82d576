"""What a camera would see of a cloud: samples of edges and of surfaces.

The cloud is drawn into coarse cells with the nearest return of each. A cell is hidden where much
nearer cells lie on both sides of it. Jumps of depth give sides and tops of things; ground below
raised things at the same depth gives their feet; steps of intensity on one surface give edges of
brightness; points far above the intensity around them are markings. An empty cell never makes an
edge: whether a scanner looked there is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled
from roadsight.poles.images.evidence import GROUND, LEVEL, MARKED, RAISED, UPRIGHT

# Kinds of samples: sides, tops and feet of things, markings, ground, raised surfaces, upright and
# level edges of brightness
SIDE, TOP, FOOT, MARK, FLAT, TALL, BRIGHT_SIDE, BRIGHT_TOP = range(8)
# Field of the image that a kind looks up
FIELD_OF: Ints = np.array([UPRIGHT, LEVEL, LEVEL, MARKED, GROUND, RAISED, UPRIGHT, LEVEL], np.int64)
# Farther returns are not used: at 80 m a cell of 3 px is 0.3 m wide, a lane's line is lost
FARTHEST_M = 80.0
_NEAREST_M = 2.0  # Nearer returns are of the vehicle itself
# Width of a cell. Narrower ones leave gaps between the beams of a 64-channel scanner at 20 m.
_CELL_PX = 3.0
_REACH = 3  # Cells that a look sideways passes at most: sparse returns leave empty ones between
# Ground is compared in intensity within squares this wide: wider than a line, narrower than a lane
_CONTRAST_CELL_M = 1.5
_FEWEST = 20  # Returns that a square needs for its spread of intensity
# A marking is so many robust standard deviations brighter than the ground around
_MARK_CONTRAST = 3.0
# Returns within this of the terrain model are ground; its error on roads is about 0.05 m
_GROUND_M = 0.2


@dataclass(frozen=True)
class SceneCloud:
    """Points near a camera.

    Attributes
    ----------
    xyz_m : (n, 3) local metres. height_m : (n,) above ground. intensity : (n,).
    contrast : (n,) of intensity among the ground around, robust standard deviations; 0 elsewhere.
    """

    xyz_m: Floats
    height_m: Floats
    intensity: Floats
    contrast: Floats

    @classmethod
    def of(cls, xyz_m: Floats, intensity: Floats, ground_m: Floats) -> SceneCloud:
        """Cloud with what is derived once.

        Parameters
        ----------
        ground_m : (n,) height of the ground below each point; points where it is not finite are
            left out.
        """
        known = np.isfinite(ground_m)
        xyz = np.ascontiguousarray(xyz_m[known], np.float64)
        height, level = xyz[:, 2] - ground_m[known], np.asarray(intensity[known], np.float64)
        is_ground = np.abs(height) < _GROUND_M
        return cls(xyz, height, level, intensity_contrast(xyz, level, is_ground))

    @classmethod
    def joined(cls, parts: list[SceneCloud]) -> SceneCloud:
        """One cloud of several; of none without any."""
        empty = cls(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0))
        whole = [empty, *parts]
        return cls(
            np.concatenate([part.xyz_m for part in whole]),
            np.concatenate([part.height_m for part in whole]),
            np.concatenate([part.intensity for part in whole]),
            np.concatenate([part.contrast for part in whole]),
        )


def intensity_contrast(xyz_m: Floats, intensity: Floats, is_ground: Bools) -> Floats:
    """Robust standard deviations (n,) by which ground is brighter than the ground around.

    0 for all else, and where a square has too few returns or one intensity alone.
    """
    contrast = np.zeros(len(xyz_m))
    own = np.flatnonzero(is_ground)
    if not len(own):
        return contrast
    cell = np.floor(xyz_m[own, :2] / _CONTRAST_CELL_M).astype(np.int64)
    cell -= cell.min(axis=0)
    key = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
    order = np.lexsort((intensity[own], key))
    key, level = key[order], intensity[own][order]
    first = np.flatnonzero(np.append(True, np.diff(key) != 0))
    count = np.diff(np.append(first, len(key)))
    median = level[first + count // 2]
    low = level[first + (count * 0.1587).astype(np.int64)]
    # From the darker side: bright lines must not widen their own yardstick.
    spread = np.maximum(median - low, 0.03 * np.median(level) + 1e-9)
    found = (level - np.repeat(median, count)) / np.repeat(spread, count)
    found[np.repeat(count, count) < _FEWEST] = 0.0
    contrast[own[order]] = found
    return contrast


def visible_samples(
    cloud: SceneCloud, rotation: Floats, position_m: Floats, lens: Floats, shape: tuple[int, int]
) -> tuple[Ints, Ints]:
    """Kinds (m,) and numbers of points (m,) of what a camera would see.

    Parameters
    ----------
    rotation : cam_from_world (3, 3). position_m : (3,). lens : (3,) focal length and principal
        point, px. shape : rows and columns of the image.
    """
    rows, columns = (int(np.ceil(size / _CELL_PX)) for size in shape)
    rotation, position_m = np.ascontiguousarray(rotation), np.ascontiguousarray(position_m)
    depth, number, uvz, cell = nearest_returns(
        cloud.xyz_m, rotation, position_m, lens, rows, columns
    )
    ends, brightness = front_returns(depth, uvz, cell, cloud.intensity)
    hidden = hidden_cells(depth)
    kinds, points = depth_edges(depth, ends, number, hidden, cloud.height_m)
    shown = np.isfinite(depth) & ~hidden
    front = number[shown]
    is_ground = np.abs(cloud.height_m[front]) < _GROUND_M
    mark = front[(cloud.contrast[front] > _MARK_CONTRAST) & is_ground]
    # Every second cell, as on a chessboard: surfaces are smooth and many.
    chess = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    surface = number[shown & chess]
    flat = surface[np.abs(cloud.height_m[surface]) < 0.1]
    tall = surface[cloud.height_m[surface] > 0.5]
    brightness = np.where(shown, brightness, np.nan)
    upright = number[brightness_edges(depth, brightness, 1)]
    level = number[brightness_edges(depth, brightness, 0)]
    groups = (MARK, mark), (FLAT, flat), (TALL, tall), (BRIGHT_SIDE, upright), (BRIGHT_TOP, level)
    all_kinds = [kinds, *(np.full(len(own), kind, np.int64) for kind, own in groups)]
    return np.concatenate(all_kinds), np.concatenate([points, *(own for _, own in groups)])


@compiled()
def nearest_returns(
    xyz_m: Floats, rotation: Floats, position_m: Floats, lens: Floats, rows: int, columns: int
) -> tuple[Floats, Ints, Floats, Ints]:
    """Nearest return of each cell of `_CELL_PX`.

    Returns
    -------
    depth (rows, columns), infinite in empty cells; its point's number, -1 in empty cells; pixel
    and depth (n, 3) of each point; its cell (n,), -1 where it is in none
    """
    depth = np.full((rows, columns), np.inf)
    number = np.full((rows, columns), -1, np.int64)
    uvz = np.empty((len(xyz_m), 3))
    cell = np.full(len(xyz_m), -1, np.int64)
    for i in range(len(xyz_m)):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(3):
            away = xyz_m[i, k] - position_m[k]
            x += rotation[0, k] * away
            y += rotation[1, k] * away
            z += rotation[2, k] * away
        if not (_NEAREST_M <= z <= FARTHEST_M):
            continue
        u, v = lens[1] + lens[0] * x / z, lens[2] + lens[0] * y / z
        a, b = int(np.floor((u + 0.5) / _CELL_PX)), int(np.floor((v + 0.5) / _CELL_PX))
        if a < 0 or b < 0 or a >= columns or b >= rows:
            continue
        uvz[i, 0], uvz[i, 1], uvz[i, 2] = u, v, z
        cell[i] = b * columns + a
        if z < depth[b, a]:
            depth[b, a], number[b, a] = z, i
    return depth, number, uvz, cell


@compiled()
def front_returns(depth: Floats, uvz: Floats, cell: Ints, intensity: Floats) -> tuple[Ints, Floats]:
    """Outermost points (rows, columns, 4) of each cell's front surface, and its mean intensity.

    The four are the numbers of the points farthest left, right, up and down, -1 in empty cells.
    """
    rows, columns = depth.shape
    ends = np.full((rows, columns, 4), -1, np.int64)
    total, count = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i in range(len(cell)):
        if cell[i] < 0:
            continue
        b, a = cell[i] // columns, cell[i] % columns
        if uvz[i, 2] > depth[b, a] * 1.02 + 0.2:
            continue
        total[b, a] += intensity[i]
        count[b, a] += 1.0
        for k in range(4):
            j = ends[b, a, k]
            axis = k // 2
            ahead = uvz[i, axis] - uvz[j, axis] if j >= 0 else 0.0
            if j < 0 or (k % 2 == 0 and ahead < 0) or (k % 2 == 1 and ahead > 0):
                ends[b, a, k] = i
    for b in range(rows):
        for a in range(columns):
            total[b, a] = total[b, a] / count[b, a] if count[b, a] > 0 else np.nan
    return ends, total


@compiled()
def hidden_cells(depth: Floats) -> Bools:
    """Cells with a much nearer one on both sides, or above and below: a sparse front hides them."""
    rows, columns = depth.shape
    out = np.zeros((rows, columns), np.bool_)
    for b in range(rows):
        for a in range(columns):
            if not np.isfinite(depth[b, a]):
                continue
            limit = depth[b, a] * 0.95 - 0.3
            left, right, up, down = False, False, False, False
            for k in range(1, _REACH + 1):
                left |= a - k >= 0 and depth[b, a - k] < limit
                right |= a + k < columns and depth[b, a + k] < limit
                up |= b - k >= 0 and depth[b - k, a] < limit
                down |= b + k < rows and depth[b + k, a] < limit
            out[b, a] = (left and right) or (up and down)
    return out


@compiled()
def depth_edges(  # noqa: PLR0912
    depth: Floats, ends: Ints, number: Ints, hidden: Bools, height_m: Floats
) -> tuple[Ints, Ints]:
    """Kinds (m,) and numbers of points (m,) of the samples at jumps of depth and at feet."""
    rows, columns = depth.shape
    kinds = np.empty(4 * rows * columns, np.int64)
    points = np.empty(4 * rows * columns, np.int64)
    m = 0
    for b in range(rows):
        for a in range(columns):
            z = depth[b, a]
            if not np.isfinite(z) or hidden[b, a]:
                continue
            height = height_m[number[b, a]]
            jump = 0.05 * z + 0.5
            for side in range(2):
                for k in range(1, _REACH + 1):
                    c = a - k if side == 0 else a + k
                    if c < 0 or c >= columns:
                        break
                    if not np.isfinite(depth[b, c]) or hidden[b, c]:
                        continue
                    if depth[b, c] > z + jump and height > 0.25:
                        kinds[m], points[m] = SIDE, ends[b, a, side]
                        m += 1
                    break
            for k in range(1, _REACH + 1):
                if b - k < 0:
                    break
                if not np.isfinite(depth[b - k, a]) or hidden[b - k, a]:
                    continue
                if depth[b - k, a] > z + jump and height > 0.25:
                    kinds[m], points[m] = TOP, ends[b, a, 2]
                    m += 1
                above = height_m[number[b - k, a]]
                if abs(height) < 0.15 and abs(depth[b - k, a] - z) < jump and above > 0.25:
                    kinds[m], points[m] = FOOT, ends[b, a, 2]
                    m += 1
                break
    return kinds[:m], points[:m]


def brightness_edges(depth: Floats, brightness: Floats, axis: int) -> Bools:
    """Cells (rows, columns) on a step of intensity along an axis, on one surface.

    Steps count where they are 2.5 times the mean around and a local maximum.
    """
    before, after = np.roll(brightness, 1, axis), np.roll(brightness, -1, axis)
    near, far = np.roll(depth, 1, axis), np.roll(depth, -1, axis)
    with np.errstate(invalid="ignore"):
        step = np.abs(after - before)
        smooth = np.isfinite(step) & np.isfinite(brightness)
        smooth &= np.abs(near - far) < 0.05 * depth + 0.3
    step = np.where(smooth, step, 0.0)
    share = np.maximum(ndimage.gaussian_filter(smooth.astype(np.float64), 8), 1e-3)
    usual = ndimage.gaussian_filter(step, 8) / share
    peak = (step >= np.roll(step, 1, axis)) & (step >= np.roll(step, -1, axis))
    return np.asarray(smooth & (step > 2.5 * usual) & (step > 0) & peak)
