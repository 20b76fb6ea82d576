"""The Parquet file of a tiled cloud as it is written, see `roadsight.io.cloud.tiles`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roadsight.base.arrays import Floats32
from roadsight.io.cloud.tile_spill import TileKey
from roadsight.io.cloud.tiles import METADATA_KEY, POSITION, Tile
from roadsight.io.records.arrow import as_table, schema_of

_WRITTEN_BYTES = 1 << 20
"""Buffer of the file: the system takes few large writes in less time than many small ones."""


@dataclass
class _Written:
    """Row groups of a tile, their points, and least and greatest x, y, z of these, each (3,)."""

    groups: list[int] = field(default_factory=list)
    rows: int = 0
    lower: Floats32 = field(default_factory=lambda: np.full(3, np.inf, np.float32))
    upper: Floats32 = field(default_factory=lambda: np.full(3, -np.inf, np.float32))

    def add(self, group: int, points: Mapping[str, NDArray]) -> None:
        """Count a row group with the columns ``points``, each of shape (n,)."""
        xyz = [points[axis] for axis in POSITION]
        self.groups.append(group)
        self.rows += len(xyz[0])
        self.lower = np.minimum(self.lower, [axis.min() for axis in xyz])
        self.upper = np.maximum(self.upper, [axis.max() for axis in xyz])


class TileFile:
    """Writes row groups of tiles in any order, then the index of them.

    Tiles are made to be read fast, which most steps do: in LZ4, with bytes of a kind together. It
    takes a fifth more room than zstd; dictionaries would take twice the time to write.

    Parameters
    ----------
    path : the Parquet file.
    types : NumPy type of each column.
    """

    def __init__(self, path: Path, types: Mapping[str, np.dtype]) -> None:
        self._schema = schema_of(types)
        self._tiles: dict[TileKey, _Written] = {}
        self._groups = 0
        self._classes: Counter[int] = Counter()
        self._stream = pa.output_stream(path, compression=None, buffer_size=_WRITTEN_BYTES)
        self._writer = pq.ParquetWriter(
            self._stream,
            self._schema,
            compression="lz4",
            use_dictionary=False,
            column_encoding=dict.fromkeys(self._schema.names, "BYTE_STREAM_SPLIT"),
            write_statistics=list(POSITION),
            write_page_checksum=True,
        )

    def write(self, tile: TileKey, points: Mapping[str, NDArray]) -> None:
        """Add points of a tile, every column of shape (n,), n at least 1, after those before."""
        rows = len(points["x"])
        self._writer.write_table(as_table(points, self._schema), row_group_size=rows)
        self._tiles.setdefault(tile, _Written()).add(self._groups, points)
        self._groups += 1
        self._classes.update(dict(enumerate(np.bincount(points["classification"]).tolist())))

    def finish(self, tile_size_m: float) -> list[Tile]:
        """Add the index, which is written when the file is closed, and return its tiles."""
        written = sorted(self._tiles.items())
        tiles = [
            Tile(ix, iy, tile.rows, (*tile.lower.tolist(), *tile.upper.tolist()))
            for (iy, ix), tile in written
        ]
        index = {
            "tile_size_m": tile_size_m,
            "tiles": [asdict(tile) for tile in tiles],
            "groups": [tile.groups for _, tile in written],
            "classes": {cls: count for cls, count in sorted(self._classes.items()) if count},
        }
        self._writer.add_key_value_metadata({METADATA_KEY: json.dumps(index).encode()})
        return tiles

    def close(self) -> None:
        """Write the end of the file."""
        try:
            self._writer.close()
        finally:
            self._stream.close()
