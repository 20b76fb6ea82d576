"""How much of what a user gave beside the clouds is about the site."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.base.doubts import tell_named
from roadsight.base.errors import InputError
from roadsight.base.shards import WHOLE
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import posed_images
from roadsight.io.images.image_shards import LabelImages
from roadsight.io.raster.orthophotos import read_orthophoto
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.io.vector.known import read_points
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vector_sources import load_local
from roadsight.poles.images.views import usable, views_of
from roadsight.stages.command import Command, keep

log = logging.getLogger("match_inputs")

PLACES, IMAGES, FOLDER, PICTURE = "places", "images", "folder", "picture"
"""Kinds: features on the map, rows about images, a folder of an image for each, an orthophoto."""
_LOOKED_AT = 64
"""Pixels a side in which an orthophoto is looked at before any work begins."""


def match_inputs(
    frame: Path,
    lists: Annotated[str, "what, kind (places, images, folder), path and crs, JSON"],
    frames: Annotated[Path | None, "frames of the videolog, where there is one"] = None,
    views: Sequence[str] = ("front",),
    *,
    doubts_path: Path,
) -> None:
    """Write the doubts about lists of which few match; one without a match is refused."""
    about, doubts = read_json(frame), []
    local = Frame.from_dict(about)
    for given in json.loads(lists):
        what, path = given["what"], given["path"]
        if given["kind"] == PLACES:
            if Path(path).suffix.lower() == ".csv" and what != "edges":
                places = read_points(path, local)[["x", "y"]].to_numpy(np.float64)
            else:
                places = load_local(Path(path), local, given["crs"]).geometry.to_numpy()
            doubts += tell_near(log, what, places, about, path)
        elif given["kind"] == PICTURE:  # refused where it cannot be read or shows another place
            west, south, _, east, north, _ = about["bounds_m"]
            cell_m = max(east - west, north - south, 1e-3) / _LOOKED_AT
            read_orthophoto(path, local, west, north, _LOOKED_AT, _LOOKED_AT, cell_m)
        elif frames is None:
            raise InputError("is about images, but there is no videolog", where=path)
        elif given["kind"] == IMAGES:
            known = set(read_table(frames, ["image"])["image"])
            named = posed_images(path)
            doubts += tell_named(log, f"{what} are of an image of the videolog", named, known, path)
        else:
            shown = views_of(usable(read_table(frames), WHOLE), tuple(views))
            paths = [view.path for view in shown]
            doubts += LabelImages(path).matching(paths, what, log).doubts
    keep(doubts, doubts_path)


main = Command(match_inputs)


if __name__ == "__main__":
    sys.exit(main())
