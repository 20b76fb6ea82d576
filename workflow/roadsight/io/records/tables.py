"""Parquet tables that carry their own description."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from roadsight.base.errors import InputError
from roadsight.io.records.arrow import open_parquet
from roadsight.io.records.atomic import atomic_path

_KEY = b"roadsight"


def write_table(
    path: str | os.PathLike[str], frame: pd.DataFrame, about: dict[str, Any] | None = None
) -> None:
    """Write ``frame`` with the JSON description ``about`` in the file's metadata."""
    table = pa.Table.from_pandas(frame, preserve_index=False, nthreads=1)
    metadata = {_KEY: json.dumps(about or {}, sort_keys=True).encode()}
    with atomic_path(path) as temporary:
        pq.write_table(
            table.replace_schema_metadata(metadata),
            temporary,
            compression="zstd",
            write_page_checksum=True,
        )


def read_table(path: str | os.PathLike[str], columns: list[str] | None = None) -> pd.DataFrame:
    """Read a table, or some of its columns.

    Raises
    ------
    InputError : the file is missing, unreadable or lacks a column.
    """
    with _readable(path), open_parquet(path) as file:
        if absent := sorted(set(columns or ()) - set(file.schema_arrow.names)):
            raise KeyError(f"no column {', '.join(absent)}")
        return file.read(columns, use_threads=False).to_pandas(use_threads=False)


def read_about(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Description that `write_table` stored, empty if none.

    Raises
    ------
    InputError : the file is missing or unreadable.
    """
    with _readable(path):
        metadata = pq.read_schema(path).metadata or {}
    return json.loads(metadata.get(_KEY, b"{}"))


@contextmanager
def _readable(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except (OSError, pa.ArrowException, KeyError) as error:
        raise InputError(
            f"cannot be read as a Parquet table ({error})",
            where=str(path),
            hint="delete it and run the workflow again",
        ) from error
