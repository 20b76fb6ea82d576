"""``roadsight score``: what poles that people checked say of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pyproj import Geod

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.commands.draw import DEGREES, axes_of
from roadsight.commands.verb import Verb
from roadsight.io.records.atomic import write_json
from roadsight.io.records.text_tables import read_text_table
from roadsight.poles.risk.checks import FEWEST, MISSED, NONE, POLE, score_checks

_GEOD = Geod(ellps="WGS84")
_TOLD_M = (3, 5, 7, 9)  # thresholds that are printed: those of the study's table 2


def run(
    checks_path: Annotated[str, "what `roadsight draw` wrote, filled in"],
    /,
    *,
    out: Annotated[Path, "JSON to write: scores by threshold, distances, accuracy"],
) -> None:
    """Write what the checked poles say of all of them.

    Raises
    ------
    InputError : a verdict or a place is not usable, or nothing was checked.
    """
    table = read_text_table(checks_path)
    axes = axes_of(table, checks_path, "found_")
    lacking = {"verdict", "stratum", "stratum_size", *axes} - set(table)
    if lacking:
        what, found = ", ".join(sorted(lacking)), ", ".join(table.columns)
        raise InputError(f"lacks {what}", where=checks_path, found=found)
    verdict = table["verdict"].fillna("").astype(str).str.strip().str.lower()
    wrong = ~verdict.isin(["", POLE, NONE, MISSED])
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "has an unknown verdict",
            where=f"{checks_path}, line {row + 2}",
            found=verdict[row],
            allowed=f"{POLE}, {NONE}, {MISSED} or empty",
        )
    drawn = verdict.isin([POLE, NONE]).to_numpy()
    if not drawn.any():
        raise InputError("holds no verdict", where=checks_path, hint="fill in the column verdict")
    true = _places(table, axes, (verdict == POLE).to_numpy(), checks_path)[drawn]
    placed = _places(table, [f"found_{axis}" for axis in axes], drawn, checks_path)[drawn]
    names = table["stratum"].fillna("").astype(str).str.strip()
    _check_rows(table, names, drawn, checks_path)
    given = names.ne("") & verdict.ne(MISSED)
    sizes = _sizes(table[given], names[given], checks_path)
    missed = int((verdict == MISSED).sum())
    error_m = _error_m(placed, true, axes == DEGREES)
    content = score_checks(error_m, missed, names[drawn].tolist(), sizes)
    content["unchecked"] = int((verdict == "").sum())
    write_json(out, content)
    print(_told(content, out))


def _check_rows(table: pd.DataFrame, names: pd.Series, drawn: Bools, path: str) -> None:
    """Each pole that was checked is one that was drawn, once."""
    lacking = drawn & names.eq("").to_numpy()
    if lacking.any():
        line = int(np.argmax(lacking)) + 2
        raise InputError(
            "has a verdict and no stratum",
            where=f"{path}, line {line}",
            hint=f"rows of your own are {MISSED}; others keep what `roadsight draw` wrote",
        )
    if "id" in table:
        ids = table["id"].where(drawn).dropna()
        repeated = ids[ids.duplicated()]
        if len(repeated):
            raise InputError("has a pole twice", where=path, found=repeated.iloc[0])


def _places(table: pd.DataFrame, columns: Sequence[str], needed: Bools, path: str) -> Floats:
    """Places (n, 2), NaN where they are not needed."""
    numbers = table[list(columns)].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    wrong = needed & ~np.isfinite(numbers).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "lacks a place",
            where=f"{path}, line {row + 2}",
            found=", ".join(table[list(columns)].iloc[row].astype(str)),
            allowed=f"numbers in {', '.join(columns)}",
        )
    if columns[0].endswith(DEGREES[0]):
        beyond = needed & ((np.abs(numbers[:, 0]) > 90) | (np.abs(numbers[:, 1]) > 360))
        if beyond.any():
            row = int(np.argmax(beyond))
            raise InputError(
                "is no place on Earth",
                where=f"{path}, line {row + 2}",
                found=numbers[row].tolist(),
                allowed="latitude within 90, longitude within 360 degrees",
            )
    return np.where(needed[:, None], numbers, np.nan)


def _sizes(table: pd.DataFrame, names: pd.Series, path: str) -> dict[str, int]:
    """Poles of each stratum."""
    sizes = pd.to_numeric(table["stratum_size"], errors="coerce")
    held = names.map(names.value_counts())
    wrong = ~(sizes >= held)
    if wrong.any():
        row = int(wrong.index.to_numpy()[int(np.argmax(wrong))])
        raise InputError(
            "has no size of its stratum, or one below the rows drawn of it",
            where=f"{path}, line {row + 2}",
            found=table["stratum_size"][row],
        )
    pairs = {(str(name), int(size)) for name, size in zip(names, sizes, strict=True)}
    found = dict(pairs)
    if len(found) < len(pairs):
        raise InputError("gives two sizes of one stratum", where=path, found=sorted(pairs))
    return found


def _error_m(found: Floats, true: Floats, degrees: bool) -> Floats:
    """East and north of found less true places (n, 2), NaN where there is none."""
    if not degrees:
        return np.asarray(found - true)
    stands = np.isfinite(true).all(axis=1)
    error = np.full(found.shape, np.nan)
    azimuth, _, distance = _GEOD.inv(*true[stands, ::-1].T, *found[stands, ::-1].T)
    turn = np.radians(azimuth)
    error[stands] = np.column_stack([distance * np.sin(turn), distance * np.cos(turn)])
    return error


def _told(content: dict[str, Any], out: Path) -> str:
    counts = (f"{content[name]} {name}" for name in ("checked", "missed", "unchecked"))
    lines = [", ".join(counts)]
    for row in content["thresholds"]:
        if row["threshold_m"] in _TOLD_M:
            f1 = "none" if row["f1"] is None else f"{row['f1']:.2f}"
            text = f"within {row['threshold_m']:g} m: {row['tp']} right, {row['fp']} wrong,"
            text += f" {row['fn']} missed, F1 {f1}"
            if row["precision_all"] is not None:
                low, high = (100 * share for share in row["precision_all_95"])
                text += (
                    f"; of all poles {100 * row['precision_all']:.0f} % ({low:.0f} to {high:.0f} %)"
                )
            lines.append(text)
    if content["unchecked_strata"]:
        names = ", ".join(content["unchecked_strata"])
        lines.append(f"of all poles nothing is said: no verdict in {names}")
    if content["nssda_m"] is None:
        lines.append(f"accuracy not stated: the standard asks for {FEWEST} poles that stand")
    else:
        lines.append(f"95 % of the poles are within {content['nssda_m']:.2f} m (NSSDA)")
    return "\n".join([*lines, str(out)])


VERB = Verb("score", "what checked poles say of all", run)
