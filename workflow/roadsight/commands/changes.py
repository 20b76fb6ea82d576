"""``roadsight changes``: what is new, gone or moved between two surveys of poles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
from pyproj import CRS, Transformer

from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb, check_positive
from roadsight.io.records.text_tables import read_text_table, write_csv
from roadsight.poles.risk.changes import STATUSES, ChangeSettings, changes

_AXES = (("latitude", "longitude"), ("lat", "lon"))
_SIGMAS = ("sigma_m", "sigma_major_m")
_TOLD = "CSV with latitude, longitude (or lat, lon; or x, y in metres); further id, kind, sigma"


def run(
    old_path: Annotated[str, f"earlier survey, such as its poles.csv: {_TOLD}"],
    new_path: Annotated[str, "later survey, likewise"],
    /,
    settings: ChangeSettings,
    *,
    out: Annotated[Path, "CSV to write: status, ids, how far moved, place"],
) -> None:
    """Write the changes.

    Raises
    ------
    InputError : a table or a value is not usable, or one has degrees and the other none.
    """
    check_positive(vars(settings))
    old, new = (_read(path) for path in (old_path, new_path))
    degrees = ["latitude" in table for table in (old, new)]
    if degrees[0] != degrees[1]:
        raise InputError(
            "one survey has latitude and longitude and the other has not",
            where=f"{old_path} and {new_path}",
            allowed="both with degrees, or both in the same metres",
        )
    if degrees[0]:
        places = pd.concat([old, new])[["latitude", "longitude"]]
        latitude, longitude = places.median() if len(places) else (0.0, 0.0)
        # Metres about the middle of the places, true to distances near it.
        plane = f"+proj=aeqd +lat_0={latitude} +lon_0={longitude} +datum=WGS84 +units=m"
        mover = Transformer.from_crs("EPSG:4326", CRS.from_proj4(plane), always_xy=True)
        for table in (old, new):
            table["x"], table["y"] = mover.transform(table["longitude"], table["latitude"])
        found = changes(old, new, settings)
        back = mover.transform(found["x"], found["y"], direction="INVERSE")
        found = found.drop(columns=["x", "y"]).assign(
            latitude=np.round(back[1], 9), longitude=np.round(back[0], 9)
        )
    else:
        found = changes(old, new, settings)
    write_csv(out, found.round({"moved_m": 3, "limit_m": 3}))
    counts = found["status"].value_counts()
    told = ", ".join(f"{int(counts.get(name, 0))} {name}" for name in STATUSES)
    print(f"{told}: {out}")


def _read(path: str) -> pd.DataFrame:
    """Objects of a survey: id, kind, places, sigma_m."""
    table = read_text_table(path)
    axes = next((pair for pair in _AXES if set(pair) <= set(table)), None)
    names = list(axes) if axes else ["x", "y"]
    if not set(names) <= set(table):
        raise InputError(
            "lacks columns",
            where=path,
            found=", ".join(table.columns),
            allowed="latitude, longitude or lat, lon or x, y",
        )
    numbers = table[names].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    wrong = ~np.isfinite(numbers).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "has no place", where=f"{path}, line {row + 2}", found=", ".join(table[names].iloc[row])
        )
    sigma = next((name for name in _SIGMAS if name in table), None)
    unknown = np.full(len(table), np.nan)
    found = pd.DataFrame(
        {
            "id": table["id"] if "id" in table else [f"row {n + 1}" for n in range(len(table))],
            "kind": table.get("kind", ""),
            "sigma_m": unknown
            if sigma is None
            else pd.to_numeric(table[sigma], errors="coerce").to_numpy(np.float64),
        }
    )
    repeated = found["id"][found["id"].duplicated()]
    if len(repeated):
        raise InputError("two objects share an id", where=path, found=repeated.iloc[0])
    columns = ["latitude", "longitude"] if axes else ["x", "y"]
    return found.assign(**dict(zip(columns, numbers.T, strict=True)))


VERB = Verb("changes", "what changed between two surveys of poles", run)
