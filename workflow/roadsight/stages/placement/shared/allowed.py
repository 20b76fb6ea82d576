"""Which candidates may carry a sensor, and at what cost beside it: zones, rules of mounting."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.vector.point_tables import read_points
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_polygons
from roadsight.placement.candidates.mounting import (
    Mounting,
    building_cost,
    cable_lengths_m,
    may_be_built,
)
from roadsight.placement.candidates.sites_for_sensors import outside_zones

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class AllowedFiles:
    """What says which candidates may carry a sensor."""

    zones: Annotated[str | None, "polygons in which no sensor may stand"] = None
    cabinets: Annotated[str | None, "points of power and fibre"] = None
    mounting: Annotated[str, "rules of mounting as JSON"] = "{}"


def allowed_candidates(
    given: AllowedFiles, candidates: pd.DataFrame, frame_path: Path, frame: Frame
) -> tuple[Bools, Floats, Floats | None]:
    """Whether each candidate (m,) may carry a sensor, its cost beside it, and its cable's length.

    Raises
    ------
    InputError : a file is not usable, a cabinet lies off the site, or no candidate is left.
    """
    rules = Mounting(**json.loads(given.mounting or "{}"))
    about = read_json(frame_path)
    cabinets = read_points(given.cabinets, frame) if given.cabinets else None
    if given.cabinets and cabinets is not None:
        places = cabinets[["x", "y"]].to_numpy(np.float64)
        tell_near(log, "cabinets", places, about, given.cabinets)
    where = str(given.cabinets or "mounting")
    cable_m = cable_lengths_m(candidates, cabinets, rules, where)
    free = np.ones(len(candidates), bool)
    if given.zones:
        zones = list(read_polygons(given.zones, frame).geometry)
        tell_near(log, "zones", np.array(zones, object), about, given.zones)
        free = outside_zones(candidates[["x", "y"]].to_numpy(np.float64), zones)
    if "mount" not in candidates:
        return free, np.zeros(len(candidates)), cable_m
    allowed = free & may_be_built(candidates, rules, cable_m)
    if len(candidates) and not allowed.any():
        raise InputError(
            "no candidate may carry a sensor",
            where=str(given.zones or "mounting"),
            found=f"{int((~free).sum())} of {len(candidates)} in zones without sensors, the others"
            " against the rules of mounting",
            hint="make the zones smaller (placement.zones) or the rules milder (mounting)",
        )
    return allowed, building_cost(candidates, rules, cable_m), cable_m
