"""Which sensor position sees which target: sparse rows by shard."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from roadsight.errors import InputError
from roadsight.io.tables import read_about, read_table, write_table

COLUMNS = ["candidate", "target", "hits"]


def write_detections(
    path: str | os.PathLike[str], detections: pd.DataFrame, about: dict[str, Any]
) -> None:
    """Write the detections of one sensor.

    Parameters
    ----------
    detections : columns candidate, target (names) and hits (beams, uint16); one row per seen
        target.
    about : ``sensor`` (its name) and whatever else describes them.
    """
    write_table(path, detections[COLUMNS], about)


def read_detections(paths: Iterable[str | os.PathLike[str]]) -> pd.DataFrame:
    """Detections of several files.

    Returns
    -------
    columns sensor, candidate, target (categories) and hits, file after file; categories are in the
    order in which they first appear

    Raises
    ------
    InputError : a file is missing, damaged, or does not name its sensor.
    """
    parts = [_read_part(path) for path in paths]
    if not parts:
        parts = [pa.table({name: pa.array([], _TYPES[name]) for name in _TYPES})]
    return pa.concat_tables(parts).unify_dictionaries().to_pandas()
