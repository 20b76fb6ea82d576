"""How dangerous poles are to vehicles that leave the road."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.poles import Hazard
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.sighting_tables import in_native, write_csv
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.poles.risk.clear_zone import SOURCE
from roadsight.poles.risk.hazard import (
    RULE,
    HazardSettings,
    Height,
    Rated,
    rate_roadside,
)
from roadsight.poles.risk.inventory import CARRIAGEWAYS
from roadsight.poles.risk.roads import roads_of
from roadsight.poles.risk.roadside import Surroundings, geometry_table, section_table
from roadsight.poles.risk.roadside_rating import SOURCES
from roadsight.poles.risk.routes import UNITS_M
from roadsight.poles.risk.scenarios import RouteTracks
from roadsight.poles.risk.shielding import Barrier, barrier_ends
from roadsight.stages.command import run_stage
from roadsight.stages.doubts import tell
from roadsight.stages.poles.hazard_layers import (
    GEOMETRY,
    geometry_lines,
    hazard_points,
    section_lines,
)
from roadsight.stages.poles.roadside_inputs import given_roads, ground_near_roads

log = logging.getLogger("rate_hazard")

PLAN = ("x", "y")
GEOMETRY_EVERY_M = 5.0
"""Spacing of the rows of road geometry: a radius or grade changes little over it."""
KINDS = {"poles": "Point", "ellipses": "Polygon", "rays": "LineString"}
"""Geometry of layers of poles that are empty."""
_NONE = ("clear_zone_m", "runout_length_m")
"""Settings that 0 leaves to the guide's tables."""


def rate_hazard(arguments: argparse.Namespace) -> None:
    """Write the hazard of each kept pole, cross-sections, and the geometry of the roads."""
    settings = HazardSettings(**{name: getattr(arguments, name) for name in vars(HazardSettings())})
    _check(settings)
    frame = Frame.from_dict(read_json(arguments.frame))
    poles = read_table(arguments.poles)
    poles = poles[poles["kept"].to_numpy(bool)].reset_index(drop=True)
    edges_m = read_table(arguments.edges, ["x", "y"]).to_numpy(np.float64)
    frames = read_table(arguments.frames, ["route", "sequence", "x", "y"])
    height = read_raster(arguments.dem, frame).sample if arguments.dem else None
    scale = grid_scale(poles, frame) if arguments.scale_factor == "simulate" else 1.0
    tracks = RouteTracks(frames.assign(**{name: frames[name] / scale for name in PLAN}))
    roads, inventory, barriers, told = given_roads(
        arguments, frame, roads_of(tracks, edges_m / scale), scale
    )
    if arguments.doubts:
        tell(told, arguments.doubts, f"poles {arguments.poles}", log)
    points = None
    if arguments.cloud and arguments.ground:
        points = ground_near_roads(arguments.cloud, arguments.ground, roads, scale)
        log.info("%d ground points near roads", len(points))
    surroundings = Surroundings(
        roads,
        _on_ground(height, scale),
        points,
        inventory,
        barriers,
        arguments.traffic == "left",
        arguments.carriageway,
    )
    objects = _with_barrier_ends(poles, barriers, frame, scale)
    rated = rate_roadside(_divided(objects, scale), edges_m / scale, surroundings, settings)
    measured = _measure(rated.table, arguments.measure_unit)
    known = objects[["id", "kind", "x", "y", "latitude", "longitude"]]
    table = pd.concat([known, rated.table, measured], axis=1)
    log.info("%d poles: %s", len(table), table["rating"].value_counts().to_dict())
    about = {"clear_zone": SOURCE, "rule": RULE, "settings": vars(settings)}
    about |= {"sources": SOURCES}
    write_table(arguments.out, table, about)
    write_csv(arguments.csv, in_native(table, frame))
    sections = section_table(
        surroundings,
        objects["id"].astype(str).tolist(),
        rated.located,
        rated.edge_m,
        rated.outward,
        rated.sections,
        arguments.section_every_m,
    )
    places = ["start_x", "start_y", "end_x", "end_y"]
    sections[places] *= scale
    geometry = geometry_table(surroundings)
    geometry[list(PLAN)] *= scale
    if arguments.geometry_csv:
        write_csv(arguments.geometry_csv, _rounded(in_native(geometry, frame)))
    if arguments.sections:
        write_table(arguments.sections, sections, {"profiles": _profiles(objects, rated)})
    if arguments.layers:
        layers = {
            name: read_layer(arguments.placed, name, frame)
            for name in ("poles", "ellipses", "rays")
            if arguments.placed
        }
        layers |= {
            "hazard": hazard_points(table, height),
            "cross_sections": section_lines(sections, height),
            "road_geometry": geometry_lines(geometry, surroundings, GEOMETRY_EVERY_M, scale),
        }
        write_layers(arguments.layers, layers, frame, KINDS | GEOMETRY)


def _profiles(objects: pd.DataFrame, rated: Rated) -> dict[str, dict[str, list[float]]]:
    """Measured heights at each object, for drawings: run and height above the edge, m."""
    found = {}
    for name, section in zip(objects["id"].astype(str), rated.sections, strict=True):
        if section is not None:
            profile = section.profile
            found[name] = {
                "run_m": np.round(profile.run_m, 3).tolist(),
                "height_m": np.round(profile.height_m, 3).tolist(),
            }
    return found


def _with_barrier_ends(
    poles: pd.DataFrame, barriers: Sequence[Barrier], frame: Frame, scale: float
) -> pd.DataFrame:
    """Poles, and the ends of barriers, which are objects themselves."""
    ends = barrier_ends(barriers)
    if ends.empty:
        return poles
    xy = ends[list(PLAN)].to_numpy(np.float64) * scale
    latitude = longitude = np.full(len(ends), np.nan)
    if frame.crs_wkt is not None:
        latitude, longitude = SiteNorth(frame).to_geographic(xy)
    ends = ends.assign(
        x=xy[:, 0], y=xy[:, 1], latitude=latitude, longitude=longitude, sigma_major_m=0.0
    )
    return pd.concat([poles, ends], ignore_index=True)


def _measure(table: pd.DataFrame, unit: str) -> pd.DataFrame:
    """The measure along the route in another unit than metres, if one is asked for."""
    if unit == "m":
        return pd.DataFrame(index=table.index)
    return pd.DataFrame({f"measure_{unit}": (table["station_m"] / UNITS_M[unit]).round(5)})


def _rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers with as many decimals as anyone reads: a tenth of a millimetre, of a per mille."""
    return table.round({name: 4 for name in table if name not in ("x", "y", "z")})


def grid_scale(poles: pd.DataFrame, frame: Frame) -> float:
    """Metres of the grid for each metre on the ellipsoid, mean over the poles; 1 without any."""
    if frame.crs_wkt is None or poles.empty:
        return 1.0
    return float(SiteNorth(frame).scale(poles[["x", "y"]].to_numpy(np.float64)).mean())


def _divided(poles: pd.DataFrame, scale: float) -> pd.DataFrame:
    return poles.assign(**{name: poles[name] / scale for name in (*PLAN, "sigma_major_m")})


def _on_ground(height: Height | None, scale: float) -> Height | None:
    return None if height is None else lambda x, y: height(scale * x, scale * y)


def _check(settings: HazardSettings) -> None:
    for name, value in vars(settings).items():
        least = 0.0 if name in _NONE else np.nextafter(0.0, 1.0)
        if not (np.isfinite(value) and value >= least):
            raise InputError("is not positive", where=name, found=value, allowed="more than 0")


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("poles", "frame", "frames", "edges", "out", "csv"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--dem", nargs="?", help="ground heights, for side slopes")
    parser.add_argument("--cloud", nargs="?", help="the cloud, for cross-sections of its points")
    parser.add_argument("--ground", nargs="?", help="which of its points are ground")
    parser.add_argument("--placed", nargs="?", help="layers of the poles, to go with the others")
    parser.add_argument("--layers", help="GeoPackage of all layers")
    parser.add_argument("--geometry-csv", help="road geometry by station")
    parser.add_argument("--sections", help="cross-sections, for the report")
    parser.add_argument("--doubts", help="JSON with what the hazard rests on")
    add_settings(parser, Hazard, "section_every_m")
    for name in ("inventory", "routes", "barriers"):
        parser.add_argument(f"--{name}", nargs="?", help="file of the user")
        parser.add_argument(f"--{name}-crs", default="", help="its CRS if it names none")
    parser.add_argument("--measure-unit", choices=tuple(UNITS_M), default="m")
    parser.add_argument("--traffic", choices=("right", "left"), default="right", help="drives so")
    parser.add_argument("--carriageway", choices=CARRIAGEWAYS, default="two-way")
    parser.add_argument("--scale-factor", choices=("simulate", "skip"), default="skip")
    for name, default in vars(HazardSettings()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=default)
    return run_stage(parser, rate_hazard, argv)


if __name__ == "__main__":
    sys.exit(main())
