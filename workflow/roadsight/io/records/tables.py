"""Parquet tables that carry their own description."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import DTypeLike, NDArray

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import unreadable
from roadsight.io.records.atomic import atomic_path

if TYPE_CHECKING:  # short steps without tables of pandas do not wait for it
    import pandas as pd

_KEY = b"roadsight"


def write_table(path: AnyPath, frame: pd.DataFrame, about: dict[str, Any] | None = None) -> None:
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


def read_table(path: AnyPath, columns: list[str] | None = None) -> pd.DataFrame:
    """Read a table, or some of its columns.

    Raises
    ------
    InputError : the file is missing, unreadable or lacks a column.
    """
    with _readable(path), open_parquet(path) as file:
        if absent := sorted(set(columns or ()) - set(file.schema_arrow.names)):
            raise KeyError(f"no column {', '.join(absent)}")
        return file.read(columns, use_threads=False).to_pandas(use_threads=False)


def read_about(path: AnyPath) -> dict[str, Any]:
    """Description that `write_table` stored, empty if none.

    Raises
    ------
    InputError : the file is missing or unreadable.
    """
    with _readable(path):
        metadata = pq.read_schema(path).metadata or {}
    return json.loads(metadata.get(_KEY, b"{}"))


@contextmanager
def _readable(path: AnyPath) -> Iterator[None]:
    try:
        yield
    except (OSError, pa.ArrowException, KeyError) as error:
        raise unreadable("a Parquet table", path, error) from error


# Parquet files that are read without threads, and columns between NumPy and Arrow without a copy.
#
# Arrow's own conversions load pandas first, which takes a short step a tenth of its time.


def open_parquet(path: AnyPath) -> pq.ParquetFile:
    """File whose pages are checked, and which no thread of Arrow's reads ahead.

    A process that may not grow cannot start one, and then Arrow waits for it for ever. Its methods
    need ``use_threads=False`` for the same reason.
    """
    return pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)


def schema_of(types: Mapping[str, DTypeLike]) -> pa.Schema:
    """Schema of numeric columns without gaps, which are written in two thirds of the time.

    Parameters
    ----------
    types : NumPy type of each column.
    """
    fields = [(name, pa.from_numpy_dtype(np.dtype(kind))) for name, kind in types.items()]
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in fields])


def as_table(columns: Mapping[str, NDArray], schema: pa.Schema) -> pa.Table:
    """Table of numeric columns (n,) of the types that the schema names."""
    arrays = []
    for name, kind in zip(schema.names, schema.types, strict=True):
        values = np.ascontiguousarray(columns[name], kind.to_pandas_dtype())
        arrays.append(pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(values)]))
    return pa.table(arrays, schema=schema)


def as_numpy(column: pa.ChunkedArray) -> NDArray:
    """Numeric column (n,) without gaps; read only where it is one piece."""
    return np.from_dlpack(column.combine_chunks())
