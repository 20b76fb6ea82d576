"""Training samples on disk, one PNG each of image, classes and inverse depth; and the record.

The record says how each network was trained and how well it does.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError

DEPTH_SCALE = 65535.0  # Stored inverse depth is this over the depth in metres; 0 is the sky.
_PARTS = ("colour", "classes", "depth")


@dataclass(frozen=True)
class Sample:
    """One rendered view.

    Parameters
    ----------
    colour : (rows, columns, 3) BGR. classes : (rows, columns) project classes.
    depth : (rows, columns) inverse depth, `DEPTH_SCALE` over metres along the optical axis.
    """

    colour: Bytes
    classes: Bytes
    depth: NDArray[np.uint16]


def write_sample(folder: str | os.PathLike[str], seed: int, number: int, sample: Sample) -> None:
    """Write view ``number`` of the site of ``seed``."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    for part in _PARTS:
        path = Path(folder) / f"{seed}_{number:03d}.{part}.png"
        unfinished = path.with_name(f".{path.name}")
        if not cv2.imwrite(str(unfinished), getattr(sample, part)):
            raise InputError("cannot be written", where=str(path))
        unfinished.replace(path)


def read_samples(
    folder: str | os.PathLike[str], first_seed: int, sites: int
) -> Iterator[tuple[int, Sample]]:
    """Seeds and views of ``sites`` sites from ``first_seed``, ordered by seed and number.

    Raises
    ------
    InputError : a site has no views, or a file is damaged or missing.
    """
    for seed in range(first_seed, first_seed + sites):
        names = sorted(path.name for path in Path(folder).glob(f"{seed}_*.depth.png"))
        if not names:
            raise InputError(
                f"has no views of the site of seed {seed}",
                where=str(folder),
                hint="run python -m roadsight_training.render_dataset first",
            )
        for name in names:
            stem = Path(folder) / name.removesuffix(".depth.png")
            parts: list[Any] = []
            for path in (f"{stem}.{part}.png" for part in _PARTS):
                pixels = cv2.imread(path, cv2.IMREAD_UNCHANGED)
                if pixels is None:
                    raise InputError("cannot be read as an image", where=path)
                parts.append(pixels)
            yield seed, Sample(*parts)


def digest(samples: Iterable[Sample]) -> str:
    """SHA-256 over the pixels of samples in their order."""
    found = hashlib.sha256()
    for sample in samples:
        for part in _PARTS:
            pixels = np.ascontiguousarray(getattr(sample, part))
            found.update(f"{part} {pixels.dtype} {pixels.shape}".encode())
            found.update(pixels.tobytes())
    return found.hexdigest()


def read_entry(path: str | os.PathLike[str], file: str) -> dict[str, Any]:
    """What the record says about ``file``; nothing if there is no record."""
    entry: dict[str, Any] = {}
    if Path(path).exists():
        entry = json.loads(Path(path).read_text()).get(file, {})
    return entry


def update_record(path: str | os.PathLike[str], file: str, entry: dict[str, Any]) -> None:
    """Put the keys of ``entry`` into the record's part about ``file``, keeping its others."""
    record = json.loads(Path(path).read_text()) if Path(path).exists() else {}
    record[file] = record.get(file, {}) | entry
    unfinished = Path(path).with_name(f".{Path(path).name}")
    unfinished.write_text(json.dumps(record, indent=2, sort_keys=True) + "\n")
    unfinished.replace(path)
