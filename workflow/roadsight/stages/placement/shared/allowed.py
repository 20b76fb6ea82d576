"""Which candidates may carry a sensor, and at what cost beside it: zones, rules of mounting."""

from __future__ import annotations

import argparse
import json
import logging

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


def add_allowed_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of stages that look only at candidates that may carry a sensor."""
    parser.add_argument("--zones", nargs="?", help="polygons in which no sensor may stand")
    parser.add_argument("--cabinets", nargs="?", help="points of power and fibre")
    parser.add_argument("--mounting", default="{}", help="rules of mounting as JSON")


def allowed_candidates(
    arguments: argparse.Namespace, candidates: pd.DataFrame, frame: Frame
) -> tuple[Bools, Floats, Floats | None]:
    """Whether each candidate (m,) may carry a sensor, its cost beside it, and its cable's length.

    Raises
    ------
    InputError : a file is not usable, a cabinet lies off the site, or no candidate is left.
    """
    rules = Mounting(**json.loads(arguments.mounting or "{}"))
    about = read_json(arguments.frame)
    cabinets = read_points(arguments.cabinets, frame) if arguments.cabinets else None
    if cabinets is not None:
        places = cabinets[["x", "y"]].to_numpy(np.float64)
        tell_near(log, "cabinets", places, about, arguments.cabinets)
    where = str(arguments.cabinets or "mounting")
    cable_m = cable_lengths_m(candidates, cabinets, rules, where)
    free = np.ones(len(candidates), bool)
    if arguments.zones:
        zones = list(read_polygons(arguments.zones, frame).geometry)
        tell_near(log, "zones", np.array(zones, object), about, arguments.zones)
        free = outside_zones(candidates[["x", "y"]].to_numpy(np.float64), zones)
    if "mount" not in candidates:
        return free, np.zeros(len(candidates)), cable_m
    allowed = free & may_be_built(candidates, rules, cable_m)
    if len(candidates) and not allowed.any():
        raise InputError(
            "no candidate may carry a sensor",
            where=str(arguments.zones or "mounting"),
            found=f"{int((~free).sum())} of {len(candidates)} in zones without sensors, the others"
            " against the rules of mounting",
            hint="make the zones smaller (placement.zones) or the rules milder (mounting)",
        )
    return allowed, building_cost(candidates, rules, cable_m), cable_m
