"""Depth maps of many candidates in one Parquet file, one row per candidate.

Ranges are whole steps in 16 bits, differences along each row, compressed by Zstandard; the file's
metadata says of which sensor they are. No step stands for no return, one for a beam not cast.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import zstandard
from numpy.typing import NDArray

from roadsight.base.arrays import AnyPath, Floats32
from roadsight.base.errors import InputError, unreadable
from roadsight.base.kernels import compiled
from roadsight.io.records.atomic import WholeFile, atomic_path
from roadsight.io.records.tables import open_parquet
from roadsight.placement.sensors.rays import NOT_CAST_M

_KEY = b"roadsight"  # of the file's metadata
_VERSION = 2  # of the layout; files of another are refused
_LEVEL = 3  # of Zstandard: its own default
# Maps of a row group, which is read as a whole: few, so that one map costs little memory.
_MAPS_IN_GROUP = 8
# Steps up to the sensor's range: a little less than the 65,535 that 16 bits hold, so that ranges
# just beyond it fit.
_MAX_STEPS = 65_000
_SCHEMA = pa.schema([("candidate", pa.string()), ("steps", pa.binary())])


@dataclass(frozen=True)
class DepthMapInfo:
    """What all depth maps of a file share.

    Parameters
    ----------
    sensor : name of the sensor. model : how they were rendered.
    rows, columns : channels (lowest first) and azimuth cells (from the lower limit).
    step_m : resolution of the stored ranges.
    """

    sensor: str
    model: str
    rows: int
    columns: int
    step_m: float


def range_step_m(max_range_m: float) -> float:
    """Step of stored ranges: the fewest whole millimetres that fit 16 bits (2 mm up to 130 m)."""
    return float(np.ceil(max_range_m / _MAX_STEPS * 1000) / 1000)


class DepthMapWriter(WholeFile):
    """Writes depth maps one after the other; the file appears when the block ends well.

    Parameters
    ----------
    path : Parquet file to write.
    info : what the maps share.
    """

    def __init__(self, path: AnyPath, info: DepthMapInfo) -> None:
        super().__init__(path)
        about = {"version": _VERSION, **asdict(info)}
        self._info = info
        self._schema = _SCHEMA.with_metadata({_KEY: json.dumps(about, sort_keys=True).encode()})
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._pending: list[tuple[str, bytes]] = []

    def _open(self, temporary: Path) -> None:
        self._writer = pq.ParquetWriter(
            temporary, self._schema, compression="none", write_page_checksum=True
        )

    def _complete(self) -> None:
        self._flush()

    def _close(self) -> None:
        self._writer.close()

    def append(self, candidate: str, range_m: Floats32) -> None:
        """Add a candidate's depth map (rows, columns), metres, 0 for no return, or `NOT_CAST_M`."""
        if range_m.shape != (self._info.rows, self._info.columns):
            raise ValueError(f"depth map of shape {range_m.shape} in a file of {self._info}")
        steps = _encode(range_m, self._info.step_m)
        self._pending.append((candidate, self._compressor.compress(steps.tobytes())))
        if len(self._pending) == _MAPS_IN_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._pending:
            columns = [pa.array(column) for column in zip(*self._pending, strict=True)]
            self._writer.write_table(pa.table(columns, schema=self._schema))
            self._pending.clear()


class DepthMaps:
    """Reads depth maps one after the other, with the memory of a few.

    Attributes
    ----------
    info : what the maps share.

    Raises
    ------
    InputError : the file is missing, damaged, or holds no depth maps.
    """

    def __init__(self, path: AnyPath) -> None:
        self._path = Path(path)
        try:
            self._file = open_parquet(self._path)
            about = json.loads(self._file.schema_arrow.metadata[_KEY])
            if about.pop("version") != _VERSION:
                raise ValueError("written by another version")
            self.info = DepthMapInfo(**about)
        except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
            raise unreadable("depth maps", self._path, error) from error

    def __len__(self) -> int:
        return int(self._file.metadata.num_rows)

    def __iter__(self) -> Iterator[tuple[str, Floats32]]:
        """Candidates and depth maps (rows, columns), metres, 0 for no return, or `NOT_CAST_M`.

        Raises
        ------
        InputError : the file is damaged.
        """
        try:
            for batch in self._file.iter_batches(batch_size=_MAPS_IN_GROUP, use_threads=False):
                for candidate, steps in zip(*batch.columns, strict=True):
                    yield candidate.as_py(), self.decode(steps.as_buffer())
        except (OSError, pa.ArrowException, zstandard.ZstdError, ValueError) as error:
            raise unreadable("depth maps", self._path, error) from error

    def only(self, candidates: Iterable[str]) -> Iterator[tuple[str, Floats32]]:
        """As iteration gives them, of these candidates only; what is not there is left out.

        Raises
        ------
        InputError : the file is damaged.
        """
        try:
            for candidate, content in self.stored(candidates):
                yield candidate, self.decode(content)
        except (zstandard.ZstdError, ValueError) as error:
            raise unreadable("depth maps", self._path, error) from error

    def candidates(self) -> list[str]:
        """Candidates in the order of their maps.

        Raises
        ------
        InputError : the file is damaged.
        """
        try:
            names = self._file.read(["candidate"], use_threads=False)["candidate"]
            return [str(name) for name in names.to_pylist()]
        except (OSError, pa.ArrowException, ValueError) as error:
            raise unreadable("depth maps", self._path, error) from error

    def stored(self, candidates: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Maps of these candidates as the file stores them, group by group.

        Raises
        ------
        InputError : the file is damaged.
        """
        wanted = pa.array(sorted(candidates), pa.string())
        try:
            for group in range(self._file.num_row_groups):
                names = self._file.read_row_group(group, ["candidate"], use_threads=False)
                found = pc.is_in(names["candidate"], wanted)
                if not pc.any(found).as_py():
                    continue
                rows = self._file.read_row_group(group, use_threads=False).filter(found)
                for row in rows.to_pylist():
                    yield row["candidate"], row["steps"]
        except (OSError, pa.ArrowException, ValueError) as error:
            raise unreadable("depth maps", self._path, error) from error

    def decode(self, content: pa.Buffer | bytes) -> Floats32:
        """The map that `stored` gives as bytes.

        Raises
        ------
        ValueError, zstandard.ZstdError : they are none.
        """
        shape = (self.info.rows, self.info.columns)
        size = 2 * shape[0] * shape[1]
        raw = zstandard.ZstdDecompressor().decompress(content, max_output_size=size)
        if len(raw) != size:
            raise ValueError(f"a depth map of {len(raw)} bytes instead of {size}")
        return _decode(np.frombuffer(raw, "<u2").reshape(shape), self.info.step_m)


@compiled()
def _encode(range_m: Floats32, step_m: float) -> NDArray[np.uint16]:
    """Whole steps, at least 2 for a return, as differences along each row modulo 2**16."""
    steps = np.empty(range_m.shape, np.uint16)
    for row in range(range_m.shape[0]):
        before = 0
        for column in range(range_m.shape[1]):
            value = range_m[row, column]
            here = 0
            if value > 0:
                here = 1 if value <= NOT_CAST_M else max(int(value / step_m + 0.5), 2)
            steps[row, column] = (here - before) & 0xFFFF
            before = here
    return steps


@compiled()
def _decode(steps: NDArray[np.uint16], step_m: float) -> Floats32:
    range_m = np.empty(steps.shape, np.float32)
    for row in range(steps.shape[0]):
        here = 0
        for column in range(steps.shape[1]):
            here = (here + int(steps[row, column])) & 0xFFFF
            range_m[row, column] = NOT_CAST_M if here == 1 else here * step_m
    return range_m


# Training pairs of a depth network, one NPZ file per scene: preliminary and refined depth maps
# (paper 1, Fig. 11) as whole steps of range, 0 for no return.

# Range of one step: 16 bits reach 262 m, farther than any sensor of the paper's Table 1.
STEP_M = 0.004
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


def stack_pairs(pairs: Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]) -> DepthPairs:
    """Pairs of maps in metres, one after the other."""
    return DepthPairs(*(np.stack([stepped(pair[part]) for pair in pairs]) for part in (0, 1)))


def write_pairs(path: AnyPath, pairs: DepthPairs) -> None:
    """Write the pairs of a scene; equal pairs give equal bytes."""
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **{part: getattr(pairs, part) for part in _PARTS})


def read_pairs(path: AnyPath) -> DepthPairs:
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
            hint="make them with roadsight_training.render_depth_dataset",
        ) from error
    if pairs.preliminary.ndim != 3 or pairs.preliminary.shape != pairs.refined.shape:
        raise InputError(
            "maps of a pair differ in size",
            where=str(path),
            found=f"{pairs.preliminary.shape} and {pairs.refined.shape}",
        )
    return pairs


def read_dataset(folder: AnyPath, truth: str) -> dict[str, DepthPairs]:
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
            hint="run python -m roadsight_training.render_depth_dataset first",
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
