"""What a plan with options reads beside the detections."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import geopandas as gpd
import numpy as np

from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Cover, Coverage
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.vector.known import attribute_numbers, read_points
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_polygons
from roadsight.placement.plans.plan_problem import Asked

log = logging.getLogger(__name__)

FILES = ("areas", "forbidden", "mandatory", "poles")
"""Options of a plan that name a file, each an argument of the stage."""


@dataclass(frozen=True, kw_only=True)
class PlanFiles:
    """A plan of a site, what it asks for beside a cover, and the maps of that."""

    site: str
    plan: str
    frame: Path
    cover: Cover
    uncoverable: Annotated[str, Coverage]
    options: Annotated[str, "options of the plan as JSON"] = ""
    areas: Annotated[Sequence[str], "file of the option"] = ()
    forbidden: Annotated[Sequence[str], "file of the option"] = ()
    mandatory: Annotated[Sequence[str], "file of the option"] = ()
    poles: Annotated[Sequence[str], "file of the option"] = ()


def read_asked(given: PlanFiles, frame: Frame) -> Asked | None:
    """Options of the plan with their maps; None where it has none.

    Raises
    ------
    InputError : a file is not usable.
    """
    if not given.options:
        return None
    options = json.loads(given.options)
    options.pop("robust", None)  # what sensors count for is settled before the plan is posed
    if not options:
        return None
    crs = {name: options.get(name, {}).get("crs") for name in FILES}
    zones, fixed, poles = given.forbidden, given.mandatory, given.poles
    asked = Asked(
        options,
        options.get("at_least", given.cover.at_least),
        f"site {given.site}, plan {given.plan}",
        _areas(given.areas[0], frame, crs["areas"]) if given.areas else None,
        read_polygons(zones[0], frame, crs["forbidden"]) if zones else None,
        read_points(fixed[0], frame, crs["mandatory"], ["height_m"], ["candidate"])
        if fixed
        else None,
        read_points(poles[0], frame, crs["poles"], ["cost", "height_min_m", "height_max_m"])
        if poles
        else None,
        given.uncoverable == "exclude",
    )
    about = read_json(given.frame)
    for what, features in (
        ("areas", asked.areas),
        ("forbidden places", asked.zones),
        ("mandatory places", asked.fixed),
        ("poles of the plan", asked.poles),
    ):
        if features is not None:
            has_shape = isinstance(features, gpd.GeoDataFrame)
            shapes = features.geometry if has_shape else features[["x", "y"]]
            tell_near(log, what, shapes.to_numpy(), about, asked.where)
    return asked


def _areas(path: str, frame: Frame, crs: str | None) -> gpd.GeoDataFrame:
    areas = read_polygons(path, frame, crs)
    stated = [name for name in ("weight", "at_least") if name in areas]
    if not stated:
        raise InputError(
            "states neither weight nor at_least of its polygons",
            where=path,
            found=", ".join(map(str, areas.columns)),
        )
    for name in ("weight", "at_least"):
        areas[name] = attribute_numbers(areas, name, path)
    whole = areas["at_least"].dropna().to_numpy(np.float64)
    if (whole % 1 != 0).any():
        wrong = float(whole[whole % 1 != 0][0])
        raise InputError("at_least is no whole number", where=path, found=wrong)
    return areas
