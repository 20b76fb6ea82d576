"""Random patches of depth maps for training (paper 1, section 2.4: 56 x 56 cells)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Floats32
from roadsight.io.records.depth_maps import STEP_M, DepthPairs
from roadsight.placement.depth.unet import normalised

PATCH_CELLS = 56  # Side of a patch, as in the paper.
_TRIES = 8  # Places that are tried for a patch with returns; the last is taken as it is.
_LEAST_RETURNS = 0.02  # Share of cells that must return: empty patches teach nothing.


class Patches(NamedTuple):
    """Patches of one step.

    Parameters
    ----------
    preliminary, refined : (n, 1, side, side), normalised by the preliminary map's least and
        greatest range. scale_m : (n, 1, 1, 1) metres of the normalised 1.
    """

    preliminary: Floats32
    refined: Floats32
    scale_m: Floats32


def random_patches(
    dataset: Sequence[DepthPairs], count: int, rng: np.random.Generator, side: int = PATCH_CELLS
) -> Patches:
    """Patches at random places of random maps, half of them mirrored.

    Places where next to nothing returns are drawn anew a few times: half of a map is sky.
    """
    drawn = [_patch(dataset, side, rng) for _ in range(count)]
    return Patches(*(np.stack(part) for part in zip(*drawn, strict=True)))


def _patch(
    dataset: Sequence[DepthPairs], side: int, rng: np.random.Generator
) -> tuple[Floats32, ...]:
    for _ in range(_TRIES):
        pairs = dataset[int(rng.integers(len(dataset)))]
        number = int(rng.integers(len(pairs)))
        row, column = (int(rng.integers(n - side + 1)) for n in pairs.refined.shape[1:])
        cells = number, slice(row, row + side), slice(column, column + side)
        if (pairs.refined[cells] > 0).mean() >= _LEAST_RETURNS:
            break
    _, low, high = normalised(pairs.preliminary[number].astype(np.float32))
    scale = np.float32(max(high - low, 1.0))
    turned = slice(None, None, -1 if rng.random() < 0.5 else 1)
    maps = [
        np.where(steps > 0, (steps - np.float32(low)) / scale, 0.0)[None, :, turned]
        for steps in (pairs.preliminary[cells], pairs.refined[cells])
    ]
    scale_m = np.full((1, 1, 1), scale * STEP_M)
    return tuple(part.astype(np.float32) for part in (*maps, scale_m))
