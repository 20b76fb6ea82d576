"""The table that a crew takes along to set out a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.geometry.crs import counted_in
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.placement.plans.handover import offsets_m, stations_m
from roadsight.report.handover.layers import sensor_table

# Degrees to a millimetre; everything else to a millimetre or a thousandth of a degree
_DECIMALS = {"latitude": 8, "longitude": 8}


def stakeout(
    plan: str, sensors: Sequence[dict[str, Any]], edges: gpd.GeoDataFrame, frame: Frame
) -> pd.DataFrame:
    """One row a sensor; docs/running/files.md says what the columns are.

    Parameters
    ----------
    sensors : entries of solution.json. edges : lines with their name (edge), local metres.
    """
    table = sensor_table(sensors, frame)
    xyz = table[["x", "y", "z"]].to_numpy(np.float64)
    native = frame.to_native(xyz)
    road = max(edges.geometry, key=lambda line: line.length)
    station = stations_m(list(edges.geometry), xyz[:, :2])
    along, beside = _along(edges, table["edge"].astype(str).tolist(), xyz[:, :2])
    found = pd.DataFrame(
        {
            "plan": plan,
            "point": [f"{plan}-{number:02d}" for number in table["number"]],
            "easting": native[:, 0],
            "northing": native[:, 1],
            "ground": native[:, 2] - table["height_m"] / frame.vertical_unit_m,
            "height": native[:, 2],
            "ground_m": table["ground_m"],
            "sensor_m": table["sensor_m"],
            "mast_m": table["height_m"],
            "azimuth_deg": table["azimuth_deg"],
            "pitch_deg": table["pitch_deg"],
            "roll_deg": table["roll_deg"],
            "sensor": table["sensor"],
            "chainage_m": station,
            "offset_m": offsets_m(road, station, xyz[:, :2]),
            "edge": table["edge"],
            "edge_m": along,
            "edge_offset_m": beside,
            "latitude": table["latitude"],
            "longitude": table["longitude"],
            "convergence_deg": np.full(len(xyz), np.nan)
            if frame.crs_wkt is None
            else SiteNorth(frame).convergence_deg(xyz[:, :2]),
            **counted_in(frame),
        }
    )
    decimals = {str(name): 3 for name in found.select_dtypes("number")} | _DECIMALS
    return found.round(decimals).replace(-0.0, 0.0)


def _along(edges: gpd.GeoDataFrame, names: list[str], xy_m: Floats) -> tuple[Floats, Floats]:
    """Length along its own edge, straight on beyond its ends, and offset to the right of it.

    NaN where no edge has the name.
    """
    lines = dict(zip(edges["edge"].astype(str), edges.geometry, strict=True))
    length, offset = np.full(len(xy_m), np.nan), np.full(len(xy_m), np.nan)
    for row, (name, place) in enumerate(zip(names, xy_m, strict=True)):
        line = lines.get(name)
        if line is None:
            continue
        length[row] = stations_m([line], place[None])[0]
        offset[row] = offsets_m(line, length[[row]], place[None])[0]
    return length, offset
