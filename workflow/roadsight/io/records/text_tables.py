"""CSV tables as spreadsheets, delivery folders and recording computers write them, as text.

Separators are commas, semicolons or tabs, whichever the header has most of; beside the other two,
numbers may have decimal commas. Rows may end with separators that the header lacks, as long as
nothing stands behind them.
"""

from __future__ import annotations

import csv
import io
import os
import re
from pathlib import Path

import pandas as pd

from roadsight.base.errors import InputError

_SEPARATORS = ",;\t"
# First bytes that tell an encoding.
_MARKS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))
_NUMBER = re.compile(r"\s*[-+]?(\d{1,3}(\.\d{3})+|\d+)?(,\d+)?([eE][-+]?\d+)?\s*")
_DECIMAL_COMMA = re.compile(r"\s*[-+]?[\d.]*,\d+([eE][-+]?\d+)?\s*")
_LONGEST_CELL = 1 << 20  # letters of a cell; more are a quotation mark that nothing closes


def read_cells(path: str | os.PathLike[str]) -> pd.DataFrame:
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
