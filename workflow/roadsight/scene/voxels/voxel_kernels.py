"""Compiled loops over sorted voxels, see `roadsight.scene.voxels.voxel_classes`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats, Ints, Ints32
from roadsight.base.kernels import compiled
from roadsight.scene.classes import BRIDGE, ROAD


@compiled(nogil=True, error_model="numpy")
def point_keys(
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    z: NDArray[np.floating],
    cls: Bytes,
    start: Floats,
    edge_m: float,
    shape: Ints,
    box: Ints,
) -> tuple[Ints, Ints]:
    """Column of points in a box of columns, and layer, class and height above its floor in 256ths.

    Parameters
    ----------
    x, y, z, cls : (n,) metres and class. start : (3,) corner of the window. shape : (3,) its cells.
    box : (4,) first column and row, columns and rows.
    """
    place, key = np.empty(len(x), np.int64), np.empty(len(x), np.int64)
    # Without branches, processors take several points at once.
    for i in range(len(x)):
        column = min(max(int(np.floor((x[i] - start[0]) / edge_m)), 0), shape[0] - 1)
        row = min(max(int(np.floor((y[i] - start[1]) / edge_m)), 0), shape[1] - 1)
        height = (z[i] - start[2]) / edge_m
        layer = min(max(int(np.floor(height)), 0), shape[2] - 1)
        part = min(max(int((height - layer) * 256.0), 0), 255)
        place[i] = (row - box[1]) * box[2] + column - box[0]
        key[i] = (layer << 16) | (np.int64(cls[i]) << 8) | part
    return place, key


@compiled(nogil=True)
def indices_of(voxel: Ints, shape: Ints, low: Ints) -> Ints32:
    """Indices ix, iy, iz (3, n) of voxel numbers (n,)."""
    indices = np.empty((3, len(voxel)), np.int32)
    for i in range(len(voxel)):
        column = voxel[i] // shape[2]
        row = column // shape[0]
        indices[0, i] = column - row * shape[0] + low[0]
        indices[1, i] = row + low[1]
        indices[2, i] = voxel[i] - column * shape[2] + low[2]
    return indices


@compiled(nogil=True)
def runs_of(keys: Ints) -> tuple[Ints, Bytes, Ints, Ints]:
    """Voxel, class, points and heights of the runs of sorted keys."""
    count = 0
    for i in range(len(keys)):
        count += i == 0 or keys[i] >> 8 != keys[i - 1] >> 8
    voxel, cls = np.empty(count, np.int64), np.empty(count, np.uint8)
    points, heights = np.zeros(count, np.int64), np.zeros(count, np.int64)
    run = -1
    for i in range(len(keys)):
        if i == 0 or keys[i] >> 8 != keys[i - 1] >> 8:
            run += 1
            voxel[run], cls[run] = keys[i] >> 16, (keys[i] >> 8) & 255
        points[run] += 1
        heights[run] += keys[i] & 255
    return voxel, cls, points, heights


@compiled(nogil=True)
def winners(
    voxel: Ints, cls: Bytes, points: Ints, heights: Ints
) -> tuple[Ints, Bytes, Ints, Ints, Ints]:
    """Voxel, class, own points, points and heights of each voxel; see `Voxels`."""
    count = 0
    for i in range(len(voxel)):
        count += i == 0 or voxel[i] != voxel[i - 1]
    number, winner = np.empty(count, np.int64), np.empty(count, np.uint8)
    own, total = np.zeros(count, np.int64), np.zeros(count, np.int64)
    height = np.zeros(count, np.int64)
    k, most, paved = -1, 0, False
    for i in range(len(voxel)):
        road = cls[i] == ROAD or cls[i] == BRIDGE
        if i == 0 or voxel[i] != voxel[i - 1]:
            k, most, paved = k + 1, 0, False
            number[k] = voxel[i]
        if road and not paved:
            paved, most = True, 0
            own[k] = height[k] = 0
        total[k] += points[i]
        if road == paved:
            own[k] += points[i]
            height[k] += heights[i]
            if points[i] > most:
                most, winner[k] = points[i], cls[i]
    return number, winner, own, total, height


@compiled(nogil=True)
def tops(
    voxel: Ints,
    cls: Bytes,
    own: Ints,
    points: Ints,
    heights: Ints,
    layers: int,
) -> tuple[Ints, Bytes, Floats, Floats]:
    """Column, class, height in layers and road share of each column; see `Columns`."""
    count = 0
    for i in range(len(voxel)):
        count += i == 0 or voxel[i] // layers != voxel[i - 1] // layers
    number, shown = np.empty(count, np.int64), np.empty(count, np.uint8)
    layer, share = np.empty(count, np.float64), np.zeros(count, np.float64)
    k, end = count, len(voxel)
    while end > 0:  # columns from the last to the first, so that each is met at its top
        column, top, first = voxel[end - 1] // layers, end - 1, end - 1
        while first > 0 and voxel[first - 1] // layers == column:
            first -= 1
        while top >= first and cls[top] != ROAD and cls[top] != BRIDGE:
            top -= 1
        paved = top >= first
        top = top if paved else end - 1
        mine, around = own[top], points[top]
        level = (voxel[top] - column * layers) * 256 * own[top] + heights[top]
        if paved:
            below, above = top - 1, top + 1
            if below >= first and voxel[below] == voxel[top] - 1:
                around += points[below]
                # The surface may pass through the floor of its voxel.
                if cls[below] == ROAD or cls[below] == BRIDGE:
                    mine += own[below]
                    level += (voxel[below] - column * layers) * 256 * own[below] + heights[below]
            if above < end and voxel[above] == voxel[top] + 1:
                around += points[above]
            share[k - 1] = mine / around
        k -= 1
        number[k], shown[k] = column, cls[top]
        layer[k] = (level / mine + 0.5) / 256.0  # heights were cut off to 256ths: half of one more
        end = first
    return number, shown, layer, share
