"""``roadsight draw``: a sample of found poles for people to check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base import SEED
from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb
from roadsight.io.records.text_tables import read_text_table, write_csv
from roadsight.poles.risk.checks import MISSED, NONE, POLE, draw, strata

DEGREES = ("latitude", "longitude")  # columns of places in degrees, WGS 84
_METRES = ("x", "y")


def run(
    poles_path: Annotated[str, "poles.csv: CSV with id and latitude, longitude (or x, y in m)"],
    /,
    count: Annotated[int, "poles to check; the accuracy standard asks for 20 at least"] = 30,
    by: Annotated[str, "column whose values, or thirds of them, are the strata"] = "sigma_major_m",
    seed: Annotated[int, "of the draw"] = SEED,
    *,
    out: Annotated[Path, "CSV to fill in"],
) -> None:
    """Write poles drawn by stratum, with columns for a checker to fill in.

    Raises
    ------
    InputError : the table lacks a column or holds no poles, or the count is not positive.
    """
    table = read_text_table(poles_path)
    axes = axes_of(table, poles_path, "")
    if by not in table or "id" not in table:
        missing = by if "id" in table else "id"
        where, found = str(poles_path), ", ".join(table.columns)
        raise InputError(f"lacks the column {missing}", where=where, found=found)
    if count < 1 or not len(table):
        poles = count if len(table) else "no poles"
        raise InputError("nothing to draw", where="--count", found=poles, allowed="1 or more")
    if seed < 0:
        raise InputError("is negative", where="--seed", found=seed, allowed="0 or more")
    if out.exists():  # what somebody has filled in stays
        before = read_text_table(str(out))
        if "verdict" in before and any(before["verdict"].fillna("").astype(str).str.strip()):
            hint = "give another file, or remove this one"
            raise InputError("holds verdicts", where=str(out), hint=hint)
    names = strata(table[by])
    rows = draw(names, count, np.random.default_rng(seed))
    drawn = table.iloc[rows]
    sizes = names.value_counts()
    empty = [""] * len(rows)
    sheet = pd.DataFrame(
        {
            "id": drawn["id"].to_numpy(),
            "stratum": names.iloc[rows].to_numpy(),
            "stratum_size": sizes[names.iloc[rows]].to_numpy(),
            **{f"found_{axis}": drawn[axis].to_numpy() for axis in axes},
            "verdict": empty,
            **dict.fromkeys(axes, empty),
            "note": empty,
        }
    )
    write_csv(out, sheet)
    print(
        f"{len(rows)} of {len(table)} poles in {sizes.size} strata of {by}: {out}\n"
        f"fill in verdict ({POLE} or {NONE}) and the true {axes[0]}, {axes[1]}; add rows {MISSED}"
        " for poles that stand\nnearer to one of these than to any other found one and are not in"
        " the file; rows without a verdict\ndo not count; then: roadsight score"
        f" {out}"
    )


def axes_of(table: pd.DataFrame, path: str, before: str) -> tuple[str, str]:
    """Names of the two columns of places, without what stands before them.

    Raises
    ------
    InputError : the table has neither degrees nor metres.
    """
    there = [pair for pair in (DEGREES, _METRES) if {before + axis for axis in pair} <= set(table)]
    for pair in there:
        # Degrees of a site without a place on Earth are empty.
        cells = table[[before + axis for axis in pair]].fillna("").astype(str)
        if (cells != "").all(axis=None) or pair == there[-1]:
            return pair
    allowed = " or ".join(", ".join(before + axis for axis in pair) for pair in (DEGREES, _METRES))
    found = ", ".join(table.columns)
    raise InputError("lacks columns", where=path, found=found, allowed=allowed)


VERB = Verb("draw", "draw found poles for people to check", run)
