"""Depth maps refined by a U-Net (paper 1, section 2.4, Figs. 10 to 12, Table 1).

Whatever the sensor, its preliminary map is made on a fine grid (0.1 degrees, Table 1), normalised
and given to the network; the refined map is cropped and resized to the sensor's own beams. Of the
two ways of deployment, `unet_depth` takes the network's ranges, and `unet_mask_depth` only where it
sees a return: there, ranges are interpolated linearly in the preliminary map.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.base.errors import InputError
from roadsight.base.kernels import compiled
from roadsight.base.sections.sensing import CellFilling
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.sensors.sensors import Sensor

# A network: normalised maps (1, 1, h, w) to refined ones and scores of a return (1, 2, h, w), or to
# refined ones alone (1, 1, h, w), as the paper's is.
Run = Callable[[Floats32], Floats32]
STEP_DEG = 0.1  # cells of the fine grid, both ways (Table 1)
MULTIPLE_CELLS = 8  # both sides of what a network sees are multiples of this
HALO_CELLS = 56  # how far around a cell the network looks, rounded up
TILE_CELLS = 720  # columns of a map that the network refines at once: bounds the memory
# How far the fine grid reaches beyond the outermost beams: Table 1 has -25 to 25 degrees for a
# field of view of -22.5 to 22.5.
_CONTEXT_DEG = 2.5
_LARGEST_STEP = 0.05  # neighbouring ranges that differ by a greater share are of two surfaces


def unet_depth(
    xyz_m: NDArray[np.floating], sensor: Sensor, position_m: ArrayLike, yaw_deg: float, *, run: Run
) -> Floats32:
    """Range of every beam as the network tells it, 0 for none; shape (rows, columns).

    Parameters
    ----------
    xyz_m, position_m, yaw_deg : as `roadsight.placement.depth.hybrid.preliminary_depth` takes them.
    run : the network.
    """
    fine = fine_sensor(sensor)
    depth_m, returns = refined(preliminary_depth(xyz_m, fine, position_m, yaw_deg), run)
    # A network may tell ranges at which the sensor measures nothing.
    seen = returns & (depth_m < sensor.range_m)
    return on_beams(np.where(seen, depth_m, np.float32(0)), fine, sensor)


def unet_mask_depth(
    xyz_m: NDArray[np.floating], sensor: Sensor, position_m: ArrayLike, yaw_deg: float, *, run: Run
) -> Floats32:
    """As `unet_depth`, but ranges are interpolated where the network sees a return."""
    fine = fine_sensor(sensor)
    preliminary = preliminary_depth(xyz_m, fine, position_m, yaw_deg)
    _, returns = refined(preliminary, run)
    return on_beams(fill_linearly(preliminary, returns), fine, sensor)


def fine_sensor(sensor: Sensor) -> Sensor:
    """Sensor of the fine grid around all azimuths: the rows of a sensor and 2.5 degrees more.

    Rows lie on one lattice for all sensors, and are those of Table 1 for a field of view of -22.5
    to 22.5 degrees. The network looks that far around the outermost beams.
    """
    lowest, highest = sensor.elevation_deg[[0, -1]]
    # Limits on the lattice stay there, whichever way their quotient rounds.
    bottom = max(math.floor((lowest - _CONTEXT_DEG) / STEP_DEG + 1e-6), round(-90 / STEP_DEG))
    top = min(math.ceil((highest + _CONTEXT_DEG) / STEP_DEG - 1e-6), round(90 / STEP_DEG))
    return grid_sensor((-180.0, 180.0), (bottom, top), sensor.range_m)


def grid_sensor(azimuth_deg: tuple[float, float], rows: tuple[int, int], range_m: float) -> Sensor:
    """Sensor whose beams are cells of the fine grid.

    Parameters
    ----------
    azimuth_deg : right and left limit. rows : lowest and highest limit, in steps from the horizon.
    """
    return Sensor.model_validate(
        {
            "azimuth_min_deg": azimuth_deg[0],
            "azimuth_max_deg": azimuth_deg[1],
            "azimuth_step_deg": STEP_DEG,
            "elevation_min_deg": (rows[0] + 0.5) * STEP_DEG,
            "elevation_max_deg": (rows[1] - 0.5) * STEP_DEG,
            "channels": rows[1] - rows[0],
            "range_m": range_m,
        }
    )


def refined(depth_m: Floats32, run: Run, *, wraps: bool = True) -> tuple[Floats32, Bools]:
    """Refined ranges (rows, columns) of a preliminary map, and where there is a return.

    A network with a score of a return decides by it. Of one without, the paper takes the non-zero
    elements of its output (Fig. 12). A regression is never exactly 0 and the text says no more; the
    guess here: an element is zero if it is nearer to 0 than to the map's least range.

    A map without any return, or with the same range everywhere, has nothing to refine and stays.

    Parameters
    ----------
    depth_m : (rows, columns) on the fine grid, 0 for no return.
    wraps : whether the last column is beside the first one.
    """
    values, low, high = normalised(depth_m)
    if not high > low:
        return depth_m, depth_m > 0
    output = _tiled(values, run, wraps)
    range_m = np.maximum(low + output[0] * np.float32(high - low), 0.0).astype(np.float32)
    if len(output) == 1:
        return range_m, range_m >= 0.5 * depth_m[depth_m > 0].min()
    return range_m, (output[1] > 0) & (range_m > 0)


def _tiled(values: Floats32, run: Run, wraps: bool) -> Floats32:
    """What the network gives, (1 or 2, rows, columns), tile by tile with enough around each."""
    rows, columns = values.shape
    padded = np.zeros((_rounded_up(rows), columns), np.float32)
    padded[:rows] = values
    tiles = []
    for first in range(0, columns, TILE_CELLS):
        last = min(first + TILE_CELLS, columns)
        around = np.arange(first - HALO_CELLS, first + _rounded_up(last - first) + HALO_CELLS)
        window = padded[:, around % columns]
        if not wraps:
            window[:, (around < 0) | (around >= columns)] = 0.0
        found = run(np.ascontiguousarray(window[None, None]))[0]
        tiles.append(found[:, :rows, HALO_CELLS : HALO_CELLS + last - first])
    return np.concatenate(tiles, axis=2)


def _rounded_up(cells: int) -> int:
    return -(-cells // MULTIPLE_CELLS) * MULTIPLE_CELLS


def on_beams(depth_m: Floats32, fine: Sensor, sensor: Sensor) -> Floats32:
    """A map of the fine grid at a sensor's beams: cropped, down-sampled and resized.

    A beam between two cells takes the range between theirs (linear in the inverse range, as a plane
    is), unless they belong to different surfaces or one has no return: then the nearer cell's.

    Parameters
    ----------
    depth_m : (rows, columns) of ``fine``, all around. sensor : whose beams lie within its rows.
    """
    column, share = _cells(sensor.azimuth_deg - fine.azimuth_deg[0])
    left, right = depth_m[:, column % fine.columns], depth_m[:, (column + 1) % fine.columns]
    across = _between(left, right, share[None, :])
    row, share = _cells(sensor.elevation_deg - fine.elevation_deg[0])
    below, above = (np.clip(row + step, 0, fine.rows - 1) for step in (0, 1))
    return _between(across[below], across[above], share[:, None])


def _cells(angle_deg: Floats) -> tuple[Ints, Floats32]:
    """Cell at or before each angle from the first one, and how far it is to the next, 0 to 1."""
    steps = np.round(angle_deg / STEP_DEG, 6)
    cell = np.floor(steps)
    return cell.astype(np.int64), (steps - cell).astype(np.float32)


def _between(one_m: Floats32, other_m: Floats32, share: Floats32) -> Floats32:
    """Range at a share of the way from one cell to the next."""
    nearer = np.where(share <= 0.5, one_m, other_m)
    least = np.minimum(one_m, other_m)
    same = (least > 0) & (np.abs(one_m - other_m) <= _LARGEST_STEP * least) & (share > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        blended = 1.0 / ((1.0 - share) / one_m + share / other_m)
    return np.where(same, blended, nearer).astype(np.float32)


def fill_linearly(depth_m: Floats32, wanted: Bools, *, wraps: bool = True) -> Floats32:
    """Ranges of the wanted cells, 0 elsewhere; shape (rows, columns).

    Known ranges stay. Others are interpolated between the nearest known cells of their row and of
    their column, and the two are weighed by how near the nearest one is. Where only one side has a
    known cell, its range is taken; without any the cell stays without return.

    Parameters
    ----------
    depth_m : (rows, columns), 0 where nothing is known. wanted : cells that have a return.
    wraps : whether the last column is beside the first one.
    """
    across = _along_rows(np.ascontiguousarray(depth_m), wraps)
    upright = _along_rows(np.ascontiguousarray(depth_m.T), False)
    total = across[1] + upright[1].T
    mixed = across[0] * across[1] + (upright[0] * upright[1]).T
    filled = np.divide(mixed, total, out=np.zeros_like(depth_m), where=total > 0)
    return np.where(wanted, np.where(depth_m > 0, depth_m, filled), 0.0).astype(np.float32)


def _along_rows(depth_m: Floats32, wraps: bool) -> tuple[Floats32, Floats32]:
    """Ranges interpolated along rows, and 1 / cells to the nearest known one, 0 if none."""
    before_m, before = _last_known(depth_m, wraps)
    mirrored = np.ascontiguousarray(depth_m[:, ::-1])
    after_m, after = (part[:, ::-1] for part in _last_known(mirrored, wraps))
    share = np.where(before > 0, np.where(after > 0, before / np.maximum(before + after, 1), 0), 1)
    value = (1 - share) * before_m + share * after_m
    nearest = np.minimum(np.where(before > 0, before, np.inf), np.where(after > 0, after, np.inf))
    return value.astype(np.float32), (1 / nearest).astype(np.float32)


@compiled()
def _last_known(depth_m: Floats32, wraps: bool) -> tuple[Floats32, Floats32]:
    """Of each cell the last known range before it in its row, and how many cells back, 0: none."""
    rows, columns = depth_m.shape
    range_m, gap = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    for row in range(rows):
        known_m, cells = np.float32(0.0), 0
        for step in range(2 * columns if wraps else columns):
            column = step % columns
            if known_m > 0:
                range_m[row, column], gap[row, column] = known_m, cells
            if depth_m[row, column] > 0:
                known_m, cells = depth_m[row, column], 0
            cells += 1
    return range_m, gap


ROWS = 500  # rows of the paper's maps: -25 to 25 degrees (Table 1)
RANGES_M = tuple(range(50, 201, 10))  # ranges of the paper's pairs (Table 1)
HEIGHTS_M = (4.0, 20.0)  # heights of the paper's sensors above the ground


def training_sensor(rng: np.random.Generator, span_deg: float) -> Sensor:
    """Sensor of Table 1 with a random range that looks ``span_deg`` wide in a random direction."""
    # On the lattice of the fine grid, and with the seam at 180 degrees never inside.
    first = STEP_DEG * int(rng.integers(-1800, 1800 - round(span_deg / STEP_DEG) + 1))
    range_m = float(rng.choice(RANGES_M))
    return grid_sensor((first, first + span_deg), (-ROWS // 2, ROWS // 2), range_m)


def normalised(depth_m: Floats32) -> tuple[Floats32, float, float]:
    """A map brought to 0 to 1, and its least and greatest range, m.

    Cells without return count as range 0, and so become 0. A map of one value everywhere has no
    contrast to stretch and is all 0.
    """
    low, high = float(depth_m.min(initial=np.inf)), float(depth_m.max(initial=0.0))
    if not high > low:
        return np.zeros_like(depth_m), high, high
    return ((depth_m - np.float32(low)) / np.float32(high - low)).astype(np.float32), low, high


_USUAL = CellFilling()
_UNETS = {"unet": unet_depth, "unet_mask": unet_mask_depth}
NETWORK_MODELS = tuple(_UNETS)  # those that need a network


def model_of_points(
    name: str, network: Run | None = None, *, filling: CellFilling = _USUAL
) -> Callable[..., Floats32]:
    """Function of points, sensor, position and yaw that gives a depth map.

    Parameters
    ----------
    name : a `DepthModel` but surfel. network : for `NETWORK_MODELS`.
    filling : of sparse cells; the hybrid model alone has it.

    Raises
    ------
    InputError : the model needs a network and there is none.
    """
    if name == "hybrid":
        names = CellFilling.model_fields
        return partial(hybrid_depth, **{name: getattr(filling, name) for name in names})
    if name not in _UNETS:
        return preliminary_depth
    if network is None:
        raise InputError("needs a network", where=name, hint="name its ONNX file")
    return partial(_UNETS[name], run=network)
