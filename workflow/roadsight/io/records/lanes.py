"""Lanes and their traffic as a table of points on their middle lines."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from roadsight.io.records.tables import read_about, read_table
from roadsight.placement.sight.lanes import Traffic, rasterise_lanes
from roadsight.placement.sight.passing import CAR, TRUCK


@dataclass(frozen=True)
class SiteTraffic:
    """Traffic of a site.

    Parameters
    ----------
    lanes : where it drives and how much of it there is.
    availability : share of the time that a line of sight must be free of it.
    """

    lanes: Traffic
    availability: float


def read_traffic(path: str | os.PathLike[str]) -> SiteTraffic:
    """Read the lanes that `trace_lanes` wrote.

    Raises
    ------
    InputError : the table cannot be read.
    """
    points = read_table(path)
    # One row per lane: its vehicles are the same all along it.
    per_m = points.groupby("lane")[["cars_per_m", "trucks_per_m"]].first().sort_index()
    lanes = rasterise_lanes(points, per_m.to_numpy(np.float64), (CAR, TRUCK))
    return SiteTraffic(lanes, float(read_about(path)["availability"]))
