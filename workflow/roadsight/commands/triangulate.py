"""``roadsight triangulate``: places of poles from sightings with bearing and depth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from roadsight.base import SEED
from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb, check_positive
from roadsight.io.records.text_tables import read_sightings, write_csv
from roadsight.poles.triangulate.geographic import (
    looks_exchanged,
    reasons_for_none,
    triangulate_geographic,
    triangulate_published,
)
from roadsight.poles.triangulate.published import PUBLISHED_DISTANCE
from roadsight.poles.triangulate.rays import UNAIDED


@dataclass(frozen=True)
class Numbers:
    """What the verb lets one state of sightings and poles."""

    max_distance_m: Annotated[
        float, "furthest pole from a camera, m; of the published code 25 of its units"
    ] = UNAIDED.max_distance_m
    sigma_position_m: Annotated[float, "error of a camera's position, m"] = UNAIDED.sigma_position_m
    sigma_bearing_deg: Annotated[
        float, "error of a bearing where the table states none, degrees"
    ] = UNAIDED.sigma_bearing_deg
    sigma_depth_ratio: Annotated[
        float, "error of a depth over the depth where the table states none"
    ] = UNAIDED.sigma_depth_ratio
    max_sigma_m: Annotated[float, "poles with a longer error ellipse are left out, m"] = (
        UNAIDED.max_sigma_m
    )


def run(
    sightings_path: Annotated[
        str,
        "CSV: lat, lon, bearing (true, degrees), depth (m);"
        " further image, sigma_bearing_deg, sigma_depth_m",
    ],
    /,
    numbers: Numbers,
    published: Annotated[bool, "behave as the published code, in a random order"] = False,
    seed: Annotated[int, "of the random order"] = SEED,
    depths_as_given: Annotated[bool, "do not calibrate the common scale of the depths"] = False,
    *,
    out: Annotated[Path, "CSV to write: lat, lon, score, sigma_m"],
) -> None:
    """Write the poles.

    Raises
    ------
    InputError : the table or a value is not usable, or there are fewer than two sightings.
    """
    check_positive(vars(numbers))
    if seed < 0:
        raise InputError("is negative", where="--seed", found=seed, allowed="0 or more")
    given = {**vars(numbers), "calibrate_depth": not depths_as_given}
    settings = UNAIDED.model_copy(update=given)
    sightings = read_sightings(sightings_path)
    if len(sightings) < 2:
        raise InputError("fewer than two sightings", where=sightings_path, found=len(sightings))
    if published:
        own = settings.model_copy(update={"max_distance_m": PUBLISHED_DISTANCE})
        poles = triangulate_published(sightings, own, seed)
    else:
        poles = triangulate_geographic(sightings, settings)
    if not len(poles) and looks_exchanged(sightings, settings):
        raise InputError(
            "lat and lon look exchanged: there are poles the other way round only",
            where=sightings_path,
            hint="swap the two columns",
        )
    write_csv(out, poles)
    print(f"{len(poles)} poles from {len(sightings)} sightings: {out}")
    if not len(poles):
        print("no pole: " + "; ".join(reasons_for_none(sightings, settings)))


VERB = Verb("triangulate", "locate poles from sightings in images", run)
