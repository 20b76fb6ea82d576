"""Voxels of a site as a Parquet file that is written piece by piece."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from roadsight.base.arrays import Bytes, Ints32
from roadsight.io.records.arrow import as_table, schema_of
from roadsight.io.records.atomic import WholeFile

_GROUP = 1 << 20
"""Rows of a row group. Groups are cut at whole multiples, so that the bytes do not depend on the
pieces in which voxels come."""
_SCHEMA = schema_of({**dict.fromkeys(("ix", "iy", "iz"), "i4"), "cls": "u1"})


class VoxelTableWriter(WholeFile):
    """Writes columns ix, iy, iz and cls; the bytes do not depend on the pieces.

    Parameters
    ----------
    path : the Parquet file. about : JSON description kept in it, read by `io.tables.read_about`.
    """

    def __init__(self, path: str | os.PathLike[str], about: dict[str, Any]) -> None:
        super().__init__(path)
        self._schema = _SCHEMA.with_metadata(
            {b"roadsight": json.dumps(about, sort_keys=True).encode()}
        )
        self._waiting: list[pa.Table] = []
        self.rows = 0

    def _open(self, temporary: Path) -> None:
        self._file = pq.ParquetWriter(
            temporary,
            self._schema,
            compression="zstd",
            write_page_checksum=True,
            use_dictionary=False,
            column_encoding=dict.fromkeys(_SCHEMA.names, "BYTE_STREAM_SPLIT"),
        )

    def _complete(self) -> None:
        self._flush(whole_groups=False)

    def _close(self) -> None:
        self._file.close()

    def add(self, indices: Ints32, cls: Bytes) -> None:
        """Add voxels: indices ix, iy, iz (n, 3) and classes (n,)."""
        columns = dict(zip(_SCHEMA.names, (*indices.T, cls), strict=True))
        self._waiting.append(as_table(columns, self._schema))
        self.rows += len(cls)
        if sum(len(part) for part in self._waiting) >= _GROUP:
            self._flush(whole_groups=True)

    def _flush(self, whole_groups: bool) -> None:
        if not self._waiting:
            return
        waiting = pa.concat_tables(self._waiting).combine_chunks()
        cut = len(waiting) // _GROUP * _GROUP if whole_groups else len(waiting)
        if cut:
            self._file.write_table(waiting.slice(0, cut), row_group_size=_GROUP)
        self._waiting = [waiting.slice(cut)]
