"""Parquet files that are read without threads, and columns between NumPy and Arrow without a copy.

Arrow's own conversions load pandas first, which takes a short step a tenth of its time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import DTypeLike, NDArray


def open_parquet(path: str | os.PathLike[str]) -> pq.ParquetFile:
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
