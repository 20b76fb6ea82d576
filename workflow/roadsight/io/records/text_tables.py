"""CSV tables of people: read as text, sightings and decisions on poles, and tables for them.

They are read as spreadsheets, delivery folders and recording computers write them. Separators are
commas, semicolons or tabs, whichever the header has most of; beside the other two, numbers may have
decimal commas. Rows may end with separators that the header lacks, as long as nothing stands behind
them.
"""

from __future__ import annotations

import csv
import io
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import InputError
from roadsight.geometry.crs import counted_in
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path

_SEPARATORS = ",;\t"
# First bytes that tell an encoding.
_MARKS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))
_NUMBER = re.compile(r"\s*[-+]?(\d{1,3}(\.\d{3})+|\d+)?(,\d+)?([eE][-+]?\d+)?\s*")
_DECIMAL_COMMA = re.compile(r"\s*[-+]?[\d.]*,\d+([eE][-+]?\d+)?\s*")
_LONGEST_CELL = 1 << 20  # letters of a cell; more are a quotation mark that nothing closes


def read_cells(path: AnyPath) -> pd.DataFrame:
    """Cells of a CSV file as text, column names without blanks around them; blank rows left out.

    Raises
    ------
    InputError : the file cannot be read, is empty or no text, or a row has more cells than columns.
    """
    rows, separator = _rows(Path(path))
    if not rows:
        raise InputError("is no CSV table (it is empty)", where=str(path))
    (_, header), *rest = rows
    while header and not header[-1].strip():
        header = header[:-1]
    names: list[str] = []  # each once: later ones of the same name are numbered
    for name in (cell.strip() for cell in header):
        found, number = name, 1
        while found in names:
            found, number = f"{name}.{number}", number + 1
        names.append(found)
    cells = []
    for line, row in rest:
        if any(cell.strip() for cell in row[len(names) :]):
            raise InputError(
                "is no CSV table: a row has more cells than the header",
                where=f"{path}, line {line}",
                found=f"{len(row)} cells",
                allowed=f"{len(names)} columns: {', '.join(names)}",
                hint="name the columns, or put cells with the separator in quotes",
            )
        cells.append([*row[: len(names)], *[""] * (len(names) - len(row))])
    table = pd.DataFrame(cells, columns=names, dtype=str)
    for name in names if separator != "," else ():
        # Decimal points, where all cells of a column are numbers and some have commas.
        filled = [cell for cell in table[name] if cell.strip()]
        commas = any(_DECIMAL_COMMA.fullmatch(cell) for cell in filled)
        if commas and all(_NUMBER.fullmatch(cell) for cell in filled):
            whole = table[name].str.replace(".", "", regex=False)
            table[name] = whole.str.replace(",", ".", regex=False)
    return table


def _rows(path: Path) -> tuple[list[tuple[int, list[str]]], str]:
    """Line number and cells of each row that is not blank, and the separator."""
    try:
        content = path.read_bytes()
        encoding = next((name for mark, name in _MARKS if content.startswith(mark)), "utf-8")
        text = content.decode(encoding).lstrip("\ufeff")
    except OSError as error:
        raise InputError("cannot be read", where=str(path), found=error.strerror) from error
    except UnicodeDecodeError as error:
        raise InputError(f"is no CSV table ({error})", where=str(path)) from error
    lines = text.splitlines()
    first = next((line for line in lines if line.strip()), "")
    separator = ""
    if re.fullmatch(r'"?sep=[,;\t]"?', first.strip(" \r\n")):  # as Excel writes it
        separator = first.strip('" \r\n')[-1]
        text = text.replace(first, "", 1)
        first = next((line for line in lines if line.strip() and line != first), "")
    separator = separator or max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    csv.field_size_limit(_LONGEST_CELL)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"is no CSV table ({error})", where=str(path)) from error
    return rows, separator


# Columns that a table of sightings must have, with the least and greatest value; both ways of
# counting angles are taken.
_NEEDED = {"lat": (-90.0, 90.0), "lon": (-180.0, 360.0), "bearing": (-360.0, 720.0)}
_DECIMALS = 4  # of written coordinates in the cloud's unit, a tenth of a millimetre in metres
_OPTIONAL = ("depth", "sigma_bearing_deg", "sigma_depth_m")


def read_sightings(path: AnyPath) -> pd.DataFrame:
    """Sightings of a CSV file: lat, lon, bearing; further depth, image and sigmas where stated.

    An empty depth or sigma is NaN (unknown).

    Raises
    ------
    InputError : the file cannot be read, lacks a column, or a number is missing or impossible.
    """
    return checked_sightings(read_text_table(path), os.fspath(path))


def checked_sightings(table: pd.DataFrame, path: str) -> pd.DataFrame:
    """Sightings of a table of texts, as `read_sightings`; ``path`` is named in messages."""
    table = table.copy()
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        raise InputError(
            f"lacks the column {', '.join(missing)}",
            where=str(path),
            found=", ".join(table.columns),
            allowed="lat, lon, bearing; further depth, image, sigma_bearing_deg, sigma_depth_m",
        )
    for name, (least, most) in _NEEDED.items():
        numbers = _numbers(path, table, name, empty_allowed=False)
        wrong = np.flatnonzero(~((numbers >= least) & (numbers <= most)))
        if len(wrong):
            raise InputError(
                f"{name} is out of range",
                where=f"{path}, line {wrong[0] + 2}",
                found=table[name].iloc[wrong[0]],
                allowed=f"{least:g} to {most:g} degrees",
            )
        table[name] = numbers
    for name in set(_OPTIONAL) & set(table):
        table[name] = _numbers(path, table, name, empty_allowed=True)
    return table


def read_text_table(path: AnyPath) -> pd.DataFrame:
    """Cells of a CSV file as text, column names in lower case without blanks around them.

    Raises
    ------
    InputError : the file cannot be read, is no CSV table or is empty.
    """
    table = read_cells(path)
    table.columns = table.columns.str.strip().str.lower()
    return table


def write_csv(path: AnyPath, table: pd.DataFrame, decimals: dict[str, int] | None = None) -> None:
    """Write a table as CSV; NaN becomes an empty cell.

    Parameters
    ----------
    decimals : digits after the point by column; other columns are written as they are.
    """
    texts = table.copy()
    for name, digits in (decimals or {}).items():
        # Adding zero turns -0 into 0.
        texts[name] = [f"{round(float(v), digits) + 0.0:.{digits}f}" for v in table[name]]
    with atomic_path(path) as temporary:
        texts.to_csv(temporary, index=False, lineterminator="\n")


def in_native(table: pd.DataFrame, frame: Frame) -> pd.DataFrame:
    """Table with columns x, y and, if there, z in native coordinates instead of local metres.

    What these are counted in stands in columns of its own, as in every table for people: headers
    with units would name the column anew in each CRS.
    """
    names = [name for name in ("x", "y", "z") if name in table]
    native = frame.to_native(table[names].to_numpy(np.float64))
    told = counted_in(frame)
    if "z" not in names:
        told = {name: told[name] for name in ("crs", "unit")}
    places = dict(zip(names, native.T.round(_DECIMALS), strict=True))
    return table.assign(**places, **told)


def _numbers(path: AnyPath, table: pd.DataFrame, name: str, empty_allowed: bool) -> np.ndarray:
    text = table[name].str.strip()
    numbers = pd.to_numeric(text, errors="coerce").to_numpy(np.float64)
    wrong = ~np.isfinite(numbers) & ~((text == "").to_numpy() & empty_allowed)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{name} is no finite number",
            where=f"{path}, line {row + 2}",
            found=repr(table[name].iloc[row]),
        )
    return numbers


# What a person decided on single poles: accepted, rejected or moved.

ACCEPT, REJECT, MOVE = "accept", "reject", "move"
_KINDS = (ACCEPT, REJECT, MOVE)
_PLACE = ["x", "y"]  # where the pole lies that is decided on
_TO = ["to_x", "to_y"]  # where it is moved to
COLUMNS = ("decision", "kind", *_PLACE, *_TO, "pole")


def read_decisions(path: AnyPath, frame: Frame) -> pd.DataFrame:
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


def write_decisions(path: AnyPath, decisions: pd.DataFrame, frame: Frame) -> None:
    """Write decisions that are in local metres, sorted by place, so that equal ones agree."""
    table = decisions[[*COLUMNS]].sort_values([*_PLACE, "kind"], ignore_index=True)
    for names in (_PLACE, _TO):
        table[names] = frame.to_native(table[names].to_numpy(np.float64)).round(4)
    write_csv(path, table)
