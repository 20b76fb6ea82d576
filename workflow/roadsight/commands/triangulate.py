"""``roadsight triangulate``: places of poles from sightings with bearing and depth."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from roadsight.base.errors import InputError
from roadsight.io.records.sighting_tables import read_sightings, write_csv
from roadsight.poles.triangulate.geographic import triangulate_geographic, triangulate_published
from roadsight.poles.triangulate.nothing import looks_exchanged, reasons_for_none
from roadsight.poles.triangulate.published import PUBLISHED_DISTANCE
from roadsight.poles.triangulate.rays import TriangulationSettings

_DEFAULTS = TriangulationSettings()
_NUMBERS = {
    "max_distance_m": "furthest pole from a camera, m; of the published code 25 of its units",
    "sigma_position_m": "error of a camera's position, m",
    "sigma_bearing_deg": "error of a bearing where the table states none, degrees",
    "sigma_depth_ratio": "error of a depth over the depth where the table states none",
    "max_sigma_m": "poles with a longer error ellipse are left out, m",
}


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("triangulate", help="locate poles from sightings in images")
    parser.add_argument(
        "sightings",
        help="CSV: lat, lon, bearing (true, degrees), depth (m);"
        " further image, sigma_bearing_deg, sigma_depth_m",
    )
    parser.add_argument(
        "--published", action="store_true", help="behave as the published code, in a random order"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the random order; default 1")
    for name, text in _NUMBERS.items():
        flag = f"--{name.replace('_', '-')}"
        default = getattr(_DEFAULTS, name)
        parser.add_argument(flag, type=float, default=default, help=f"{text}; default {default:g}")
    parser.add_argument(
        "--depths-as-given",
        action="store_true",
        help="do not calibrate the common scale of the depths",
    )
    parser.add_argument("-o", "--out", required=True, help="CSV to write: lat, lon, score, sigma_m")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write the poles.

    Raises
    ------
    InputError : the table or a value is not usable, or there are fewer than two sightings.
    """
    settings = _settings(arguments)
    sightings = read_sightings(arguments.sightings)
    if len(sightings) < 2:
        raise InputError(
            "fewer than two sightings", where=arguments.sightings, found=len(sightings)
        )
    if arguments.published:
        own = replace(settings, max_distance_m=PUBLISHED_DISTANCE)
        poles = triangulate_published(sightings, own, arguments.seed)
    else:
        poles = triangulate_geographic(sightings, settings)
    if not len(poles) and looks_exchanged(sightings, settings):
        raise InputError(
            "lat and lon look exchanged: there are poles the other way round only",
            where=arguments.sightings,
            hint="swap the two columns",
        )
    write_csv(arguments.out, poles)
    print(f"{len(poles)} poles from {len(sightings)} sightings: {arguments.out}")
    if not len(poles):
        print("no pole: " + "; ".join(reasons_for_none(sightings, settings)))


def _settings(arguments: argparse.Namespace) -> TriangulationSettings:
    values = {name: getattr(arguments, name) for name in _NUMBERS}
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            flag = f"--{name.replace('_', '-')}"
            raise InputError("is not positive", where=flag, found=value, allowed="more than 0")
    if arguments.seed < 0:
        raise InputError("is negative", where="--seed", found=arguments.seed, allowed="0 or more")
    return replace(_DEFAULTS, calibrate_depth=not arguments.depths_as_given, **values)
