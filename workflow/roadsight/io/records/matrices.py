"""Coverage matrices: SciPy and NumPy files, and the text formats of public covering instances."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from roadsight.base.arrays import AnyPath, Floats, Ints, Numbers
from roadsight.base.errors import InputError

_NPZ = "a sparse matrix written by scipy.sparse.save_npz"
# Rows and columns together: a damaged file may announce any number, and memory grows with it.
_MOST = 100_000_000
_NPY = "a 1-D array of numbers written by numpy.save"


def read_matrix(path: AnyPath) -> sparse.csr_matrix:
    """Where a SciPy ``.npz`` file has positive entries, as a matrix of bool.

    Repeated entries are not added up in the file's type, in which they may wrap to 0.

    Raises
    ------
    InputError : missing, damaged, no 2-D matrix, or an entry is negative, infinite or NaN.
    """
    _check_exists(path)
    try:
        loaded = sparse.load_npz(path)
        if loaded.ndim != 2:
            raise ValueError(f"{loaded.ndim}-D")
        _check_size(*loaded.shape)
        if hasattr(loaded, "check_format"):
            loaded.check_format(full_check=True)
        entries = loaded.tocoo()
    except Exception as error:  # a damaged archive raises of every kind
        raise InputError(
            f"cannot be read as a sparse matrix ({error})", where=str(path), allowed=_NPZ
        ) from error
    if entries.dtype.kind not in "biuf":
        raise InputError("is not numeric", where=str(path), found=f"type {entries.dtype}")
    if not np.isfinite(entries.data).all() or (entries.data < 0).any():
        raise InputError(
            "has entries that are negative or not finite", where=str(path), allowed="0 or more"
        )
    covers = entries.data > 0
    place = entries.row[covers], entries.col[covers]
    matrix = sparse.csr_matrix((covers[covers], place), shape=entries.shape)
    matrix.sum_duplicates()
    return matrix


def read_vector(path: AnyPath, dimensions: int = 1) -> NDArray[np.generic]:
    """Array of numbers of a NumPy ``.npy`` file, 1-D if not asked for otherwise.

    Raises
    ------
    InputError : missing, damaged, of other dimensions or not numeric.
    """
    _check_exists(path)
    try:
        values = np.load(path, allow_pickle=False)
    except Exception as error:  # as above
        raise InputError(
            f"cannot be read as an array ({error})", where=str(path), allowed=_NPY
        ) from error
    array = isinstance(values, np.ndarray) and values.ndim == dimensions
    if not array or values.dtype.kind not in "biuf":
        found = getattr(values, "shape", "an archive")
        raise InputError("holds no list of numbers", where=str(path), found=found, allowed=_NPY)
    return values


def read_set_list(path: AnyPath) -> tuple[sparse.csr_matrix, Floats]:
    """Matrix (sets, elements) and costs of a text file with one line for each set.

    First line: numbers of elements and sets. Then per set: its cost, its elements (from 0).

    Raises
    ------
    InputError : missing, not of this format, or an element is out of range.
    """
    lines = [line for line in _numbers_by_line(path) if len(line)]
    if not lines or len(lines[0]) != 2:
        raise InputError("does not begin with two numbers", where=str(path))
    elements, sets = (int(value) for value in lines[0])
    if len(lines) - 1 != sets:
        raise InputError(
            "has missing or spare lines",
            where=str(path),
            found=len(lines) - 1,
            allowed=f"{sets} sets",
        )
    rows = [line[1:] for line in lines[1:]]
    costs = np.array([line[0] for line in lines[1:]], np.float64)
    return _pattern(path, rows, elements), costs


def read_element_list(path: AnyPath) -> sparse.csr_matrix:
    """Matrix (sets, elements) of a text file that lists for each element the sets that cover it.

    First the numbers of elements and sets; then per element its number, how many sets cover it,
    and their numbers (from 0). Line ends do not matter.

    Raises
    ------
    InputError : missing, not of this format, or a number is out of range.
    """
    lines = _numbers_by_line(path)
    values = np.concatenate([*lines, np.empty(0)]).astype(np.int64)
    if len(values) < 2:
        raise InputError("does not begin with two numbers", where=str(path))
    elements, sets = (int(value) for value in values[:2])
    if elements < 0 or 2 + 2 * elements > len(values):
        raise InputError("ends early", where=str(path), found=f"{elements} elements announced")
    columns: list[Ints] = [np.empty(0, np.int64)] * elements
    at = 2
    for _ in range(elements):
        head = values[at : at + 2]
        known = len(head) == 2 and 0 <= head[0] < elements and head[1] >= 0
        if not known or at + 2 + head[1] > len(values):
            raise InputError("ends early or names an unknown element", where=str(path))
        columns[head[0]] = values[at + 2 : at + 2 + head[1]]
        at += 2 + int(head[1])
    if at != len(values):
        raise InputError("has spare numbers at its end", where=str(path), found=len(values) - at)
    return _pattern(path, columns, sets).T.tocsr()


def _check_size(rows: int, columns: int) -> None:
    if rows + columns > _MOST:
        raise ValueError(f"{rows} rows and {columns} columns are more than {_MOST}")


def _check_exists(path: AnyPath) -> None:
    if not Path(path).is_file():
        raise InputError("is no file", where=str(path), hint="check the path")


def _numbers_by_line(path: AnyPath) -> list[Floats]:
    _check_exists(path)
    try:
        text = Path(path).read_text(encoding="ascii")
        lines = [np.array(line.split(), np.float64) for line in text.splitlines()]
    except ValueError as error:
        raise InputError(f"holds other than numbers ({error})", where=str(path)) from error
    endless = [number for number, line in enumerate(lines, 1) if not np.isfinite(line).all()]
    if endless:
        raise InputError("holds numbers that are not finite", where=f"{path}: line {endless[0]}")
    return lines


def _pattern(path: AnyPath, rows: Sequence[Numbers], columns: int) -> sparse.csr_matrix:
    try:
        _check_size(len(rows), columns)
    except ValueError as error:
        raise InputError("announces too much", where=str(path), found=error) from error
    start = np.cumsum([0] + [len(row) for row in rows])
    index = np.concatenate([*rows, np.empty(0)]).astype(np.int64)
    if len(index) and (index.min() < 0 or index.max() >= columns):
        raise InputError(
            "has a number out of range", where=str(path), allowed=f"0 to {columns - 1}"
        )
    matrix = sparse.csr_matrix((np.ones(len(index), np.int8), index, start), (len(rows), columns))
    matrix.sum_duplicates()
    return matrix
