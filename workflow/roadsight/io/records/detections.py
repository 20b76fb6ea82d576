"""Which sensor position sees which target: sparse rows by shard."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import union_categoricals

from roadsight.base.errors import InputError
from roadsight.io.records.tables import read_about, read_table, write_table

_COLUMNS = ["candidate", "target", "hits"]
_AVAILABILITY = "availability"


def write_detections(
    path: str | os.PathLike[str], detections: pd.DataFrame, about: dict[str, Any]
) -> None:
    """Write the detections of one sensor.

    Parameters
    ----------
    detections : candidate, target (names, best as categories) and hits (beams, uint16); one row
        per seen target; and availability (share of the time that traffic leaves it in sight), if
        that was simulated.
    about : ``sensor`` (its name) and whatever else describes them.
    """
    optional = [name for name in (_AVAILABILITY,) if name in detections]
    write_table(path, detections[[*_COLUMNS, *optional]], about)


def read_seen_targets(
    path: str | os.PathLike[str], allowed: set[str] | None = None
) -> tuple[str, pd.Index]:
    """Sensor of one file and the targets that it sees from anywhere, each once.

    Parameters
    ----------
    allowed : only from these candidates, in whatever pose; None: from all of them.

    Raises
    ------
    InputError : as `read_detections`.
    """
    if allowed is None:
        targets = read_table(path, ["target"])["target"]
    else:
        table = read_table(path, ["candidate", "target"]).astype({"candidate": "category"})
        places = table["candidate"].cat.categories.astype(str)
        free = np.array([name.partition("@")[0] in allowed for name in places], bool)
        targets = table["target"][free[table["candidate"].cat.codes.to_numpy()]]
    return _sensor_of(path), pd.Index(targets.unique().astype(str))


def read_detections(paths: Iterable[str | os.PathLike[str]]) -> pd.DataFrame:
    """Detections of several files, one after the other.

    Returns
    -------
    columns sensor, candidate, target (categories, in the order in which files name them), hits and,
    where traffic was simulated, availability

    Raises
    ------
    InputError : a file is missing, damaged, or does not name its sensor.
    """
    parts = [part for part in map(_read_part, paths) if len(part)]
    if not parts:
        return pd.DataFrame({name: [] for name in ("sensor", *_COLUMNS)})
    columns: dict[str, Any] = {
        name: union_categoricals([part[name] for part in parts])
        for name in ("sensor", "candidate", "target")
    }
    numbers = [name for name in ("hits", _AVAILABILITY) if all(name in part for part in parts)]
    for name in numbers:
        columns[name] = pd.concat([part[name] for part in parts], ignore_index=True)
    return pd.DataFrame(columns)


def _read_part(path: str | os.PathLike[str]) -> pd.DataFrame:
    part, sensor = read_table(path), _sensor_of(path)
    part["sensor"] = pd.Categorical.from_codes(np.zeros(len(part), np.int8), pd.Index([sensor]))
    return part.astype({"candidate": "category", "target": "category"})


def _sensor_of(path: str | os.PathLike[str]) -> str:
    sensor = read_about(path).get("sensor")
    if not isinstance(sensor, str):
        raise InputError(
            "does not say of which sensor its detections are",
            where=str(path),
            hint="delete it and run the workflow again",
        )
    return sensor
