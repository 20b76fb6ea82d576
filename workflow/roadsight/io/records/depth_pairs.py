"""Training pairs of a depth network on disk: preliminary and refined depth maps (paper 1, Fig. 11).

Maps are stored as whole steps of range, 0 for no return, one NPZ file per scene.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path

STEP_M = 0.004
"""Range of one step: 16 bits reach 262 m, farther than any sensor of the paper's Table 1."""

_PARTS = ("preliminary", "refined")


@dataclass(frozen=True)
class DepthPairs:
    """Preliminary and refined maps of some sensors.

    Parameters
    ----------
    preliminary, refined : (n, rows, columns), steps of `STEP_M`, 0 for no return.
    """

    preliminary: NDArray[np.uint16]
    refined: NDArray[np.uint16]

    def __len__(self) -> int:
        return len(self.preliminary)


def stepped(range_m: NDArray[np.floating]) -> NDArray[np.uint16]:
    """Ranges in metres as whole steps; a return is never rounded to none."""
    steps = np.clip(np.rint(range_m / STEP_M), 1, 65535)
    return np.where(range_m > 0, steps, 0).astype(np.uint16)


def stack_pairs(
    pairs: Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]],
) -> DepthPairs:
    """Pairs of maps in metres, one after the other."""
    return DepthPairs(*(np.stack([stepped(pair[part]) for pair in pairs]) for part in (0, 1)))


def write_pairs(path: str | os.PathLike[str], pairs: DepthPairs) -> None:
    """Write the pairs of a scene; equal pairs give equal bytes."""
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **{part: getattr(pairs, part) for part in _PARTS})


def read_pairs(path: str | os.PathLike[str]) -> DepthPairs:
    """Pairs of a scene.

    Raises
    ------
    InputError : the file is missing, damaged or none of this kind.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            pairs = DepthPairs(*(content[part] for part in _PARTS))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            "holds no pairs of depth maps",
            where=str(path),
            found=str(error),
            hint="make them with roadsight.training.render_depth_dataset",
        ) from error
    if pairs.preliminary.ndim != 3 or pairs.preliminary.shape != pairs.refined.shape:
        raise InputError(
            "maps of a pair differ in size",
            where=str(path),
            found=f"{pairs.preliminary.shape} and {pairs.refined.shape}",
        )
    return pairs


def read_dataset(folder: str | os.PathLike[str], truth: str) -> dict[str, DepthPairs]:
    """Pairs of every scene in a folder by name, ordered by it.

    Parameters
    ----------
    truth : the files ``*.<truth>.npz`` are read.

    Raises
    ------
    InputError : there are none, or one is damaged.
    """
    paths = sorted(Path(folder).glob(f"*.{truth}.npz"))
    if not paths:
        raise InputError(
            f"has no pairs with the truth {truth!r}",
            where=str(folder),
            hint="run python -m roadsight.training.render_depth_dataset first",
        )
    return {path.name.removesuffix(f".{truth}.npz"): read_pairs(path) for path in paths}


def digest(dataset: Iterable[DepthPairs]) -> str:
    """SHA-256 over the cells of all pairs in their order."""
    found = hashlib.sha256()
    for pairs in dataset:
        for part in _PARTS:
            cells = np.ascontiguousarray(getattr(pairs, part))
            found.update(f"{part} {cells.dtype} {cells.shape}".encode())
            found.update(cells.tobytes())
    return found.hexdigest()
