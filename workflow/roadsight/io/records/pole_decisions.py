"""What a person decided on single poles: accepted, rejected or moved."""

from __future__ import annotations

import os

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.sighting_tables import read_text_table, write_csv

ACCEPT, REJECT, MOVE = "accept", "reject", "move"
_KINDS = (ACCEPT, REJECT, MOVE)
_PLACE = ["x", "y"]
"""Where the pole lies that is decided on."""
_TO = ["to_x", "to_y"]
"""Where it is moved to."""
COLUMNS = ("decision", "kind", *_PLACE, *_TO, "pole")


def read_decisions(path: str | os.PathLike[str], frame: Frame) -> pd.DataFrame:
    """Decisions as `COLUMNS`: x, y and to_x, to_y in local metres (NaN where nothing moves).

    Parameters
    ----------
    path : CSV with decision (accept, reject, move), kind of the pole, x, y where it was computed
        and to_x, to_y where a moved one stands, in the CRS and units of the site; pole is its name
        at that time, for people.

    Raises
    ------
    InputError : the table cannot be read, lacks a column, or a cell is not as it should be.
    """
    table = read_text_table(path)
    if missing := [name for name in COLUMNS[:-1] if name not in table]:
        raise InputError("lacks columns", where=os.fspath(path), found=", ".join(missing))
    wrong = ~table["decision"].isin(_KINDS).to_numpy()
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "is no decision",
            where=f"{path}, line {row + 2}",
            found=table["decision"].iloc[row],
            allowed=", ".join(_KINDS),
        )
    found = table.reindex(columns=[*COLUMNS], fill_value="")
    moves = (table["decision"] == MOVE).to_numpy()
    found[_PLACE] = _local(table, _PLACE, np.ones(len(table), bool), frame, path)
    found[_TO] = _local(table, _TO, moves, frame, path)
    return found


def _local(
    table: pd.DataFrame, names: list[str], used: np.ndarray, frame: Frame, path: object
) -> np.ndarray:
    """Places (n, 2) in local metres; NaN where they are not used."""
    numbers = np.array(table[names].apply(pd.to_numeric, errors="coerce"), np.float64)
    wrong = used & ~np.isfinite(numbers).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{names[0]} or {names[1]} is no finite number",
            where=f"{path}, line {row + 2}",
            found=", ".join(table[names].iloc[row]),
        )
    numbers[~used] = np.nan
    return np.asarray(frame.to_local(numbers))


def write_decisions(path: str | os.PathLike[str], decisions: pd.DataFrame, frame: Frame) -> None:
    """Write decisions that are in local metres, sorted by place, so that equal ones agree."""
    table = decisions[[*COLUMNS]].sort_values([*_PLACE, "kind"], ignore_index=True)
    for names in (_PLACE, _TO):
        table[names] = frame.to_native(table[names].to_numpy(np.float64)).round(4)
    write_csv(path, table)
