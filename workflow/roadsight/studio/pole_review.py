"""Poles as the workflow computed them, the images that saw them, and what a person decides."""

from __future__ import annotations

import threading
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from roadsight.base.errors import InputError
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.tables import read_table
from roadsight.io.records.text_tables import COLUMNS, read_decisions, write_decisions
from roadsight.poles.triangulate.site import nearest_poles
from roadsight.report.poles_layers import finite, match_sightings
from roadsight.studio.drawing import Metre
from roadsight.studio.drive_views import images_of, picture_type
from roadsight.studio.project import Project, SiteFolder
from roadsight.studio.requests import Body
from roadsight.studio.site_files import Writer, save_beside, saving, site_version

_POLES = "poles/poles.parquet"
_FRAMES = "poles/frames.parquet"
_HAZARD = "poles/hazard.parquet"
_FILE = "pole_decisions.csv"

_SHOWN = (
    "id", "kind", "x", "y", "z", "score", "sigma_major_m", "sigma_minor_m", "sigma_azimuth_deg",
    "kept", "reason",
)  # fmt: skip

_SEEN = ("image", "view", "u_foot", "v_foot", "u_min", "v_min", "u_max", "v_max", "x", "y")
_SIGHTING = (*_SEEN, "bearing_grid_deg", "depth_m", "kept", "kind")
_PATHS = {"front": "path", "left": "left_path", "right": "right_path"}
_SAME_M = 0.01  # A decision and a pole so close belong together; files round places more finely


class Decision(Body):
    """What a person decided on one pole, in local metres."""

    decision: Literal["accept", "reject", "move"]
    kind: Annotated[str, Field(pattern=r"^[\w-]{1,40}$")]
    x: Metre
    y: Metre
    to_x: Metre | None = None
    to_y: Metre | None = None
    pole: Annotated[str, Field(pattern=r"^[\w.-]{0,60}$")] = ""


class Decisions(Body):
    """All decisions of a site."""

    decisions: Annotated[list[Decision], Field(max_length=20_000)]


def review(site: SiteFolder) -> dict[str, Any]:
    """Poles, what sees each of them, and the decisions so far.

    Returns
    -------
    poles : of each the columns of the table, where it was computed (base), the number of the
        decision on it (or None) and its sightings (image, view, place of the camera, pixels).
    decisions : as `Decision`. gone : numbers of decisions whose pole is not there any more.

    Raises
    ------
    InputError : a result is not there yet, or damaged.
    """
    version = site_version(site, "decisions")
    poles = read_table(site.file(_POLES))
    path = site.resolved.beside(site.resolved.site.poles.decisions)
    decisions = pd.DataFrame({name: pd.Series(dtype=object) for name in COLUMNS})
    if path is not None:
        decisions = read_decisions(path, site.frame())
    base = _computed(poles, decisions)
    rows = nearest_poles(base, decisions)
    shards = range(site.resolved.settings.shards)
    paths = [site.file(f"poles/sightings/{shard}.parquet") for shard in shards]
    seen = pd.concat([read_table(path, [*_SIGHTING]) for path in paths], ignore_index=True)
    owner = match_sightings(seen, base)
    hazard: dict[str, str] = {}
    if (site.results / _HAZARD).exists():
        table = read_table(site.results / _HAZARD, ["id", "rating"])
        hazard = dict(zip(table["id"].astype(str), table["rating"].astype(str), strict=True))
    listed = [
        {
            **{name: finite(row[name]) for name in _SHOWN},
            "base": [row_base["x"], row_base["y"]],
            "hazard": hazard.get(str(row["id"]), ""),
            "decision": next((n for n in np.flatnonzero(rows == number).tolist()), None),
            "seen": _plain(seen.loc[owner == number, [*_SEEN, "depth_m"]]),
        }
        for number, (row, row_base) in enumerate(
            zip(poles.to_dict("records"), base.to_dict("records"), strict=True)
        )
    ]
    return {
        "version": version,
        "poles": listed,
        "decisions": _plain(decisions[[*COLUMNS]]),
        "gone": np.flatnonzero(rows < 0).tolist(),
    }


def _plain(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [
        {str(name): finite(value) for name, value in row.items()}
        for row in table.to_dict("records")
    ]


def _computed(poles: pd.DataFrame, decisions: pd.DataFrame) -> pd.DataFrame:
    """Poles where they were before the workflow moved any as asked."""
    base = poles.reset_index(drop=True).copy()
    if "decided" not in base:
        return base
    place = base[["x", "y"]].to_numpy(np.float64).copy()
    here, there = (decisions[xy].to_numpy(np.float64) for xy in (["x", "y"], ["to_x", "to_y"]))
    for row in np.flatnonzero((base["decided"] == "moved").to_numpy()):
        apart = np.nan_to_num(np.linalg.norm(there - place[row], axis=1), nan=np.inf)
        if len(apart) and apart.min() < _SAME_M:
            place[row] = here[int(apart.argmin())]
    base[["x", "y"]] = place
    return base


def save_decisions(project: Project, stem: str, asked: list[Decision]) -> list[str]:
    """Keep decisions beside the site's settings; none: the site names no such file any more.

    Returns
    -------
    files that changed, relative to the project

    Raises
    ------
    InputError : a moved pole has no new place, or the site file cannot be changed.
    """
    for one in asked:
        if (one.decision == "move") != (one.to_x is not None and one.to_y is not None):
            raise InputError("a moved pole, and no other, needs a new place", where=one.pole)
    table = pd.DataFrame([one.model_dump() for one in asked], columns=[*COLUMNS])
    named = {"decisions": _FILE if asked else None}
    with saving(project, stem, "decisions") as site:
        writer = partial(write_decisions, decisions=table, frame=site.frame())
        files: dict[str, Writer] = {_FILE: writer} if asked else {}
        return save_beside(project, site, "poles", files, named)


class Pictures:
    """Images of poles; the folder of the site that was asked for last is walked once."""

    def __init__(self) -> None:
        self._source: ImageSource | None = None
        self._lock = threading.Lock()

    def of(self, site: SiteFolder, image: str, view: str) -> tuple[bytes, str]:
        """Bytes of an image that the videolog names, and their type.

        Raises
        ------
        InputError : no such image.
        """
        frames = read_table(site.file(_FRAMES))
        rows = frames[frames["image"] == image]
        column = _PATHS.get(view)
        if rows.empty or column is None or not str(rows[column].iloc[0] or ""):
            raise InputError("no such image", where=f"site {site.stem}", found=f"{image}, {view}")
        name = str(rows[column].iloc[0])
        kind, path = picture_type(name), Path(images_of(site))
        with self._lock:
            if self._source is not None and self._source.path == path:
                with suppress(InputError):  # what it had found may have changed
                    return self._source.content(name), kind
            self._source = ImageSource(path)
            return self._source.content(name), kind
