"""Things beside the road as objects, and the scene without those that a site removes."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError, nearest
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.scene_tables import read_surfels, write_surfels
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import points, write_layers
from roadsight.placement.sight.objects import objects_of
from roadsight.stages.command import Command

log = logging.getLogger("gather_objects")

_LISTED = 12
"""No more objects than these are listed in a message."""


def gather_objects(
    site: str,
    surfels_path: Path,
    dem_path: Path,
    frame_path: Path,
    remove: Annotated[Sequence[str], "names of objects"] = (),
    *,
    objects_path: Path,
    members: Path,
    left_path: Path,
) -> None:
    """Write the objects, which surfels are theirs, and the surfels that are left.

    Objects that are removed stay in the layer, marked so, and own no surfels.
    """
    frame = Frame.from_dict(read_json(frame_path))
    surfels = read_surfels(surfels_path)
    dem = read_raster(dem_path, frame)
    ground = dem.sample(surfels.centre_m[:, 0], surfels.centre_m[:, 1])
    height_m = surfels.centre_m[:, 2].astype(np.float64) - ground
    row, objects = objects_of(surfels.centre_m, surfels.normal, height_m)
    removed = _removed(remove, site, objects_path, objects)
    objects["removed"] = objects["name"].isin(removed).astype(np.int32)
    gone = np.isin(row, np.flatnonzero(objects["removed"]))
    write_surfels(left_path, surfels.select(~gone), {"removed": sorted(removed)})
    centres = pd.DataFrame(surfels.centre_m, columns=["x", "y", "z"])
    stays = (row >= 0) & ~gone
    part = centres[stays].reset_index(drop=True)
    part["object"] = pd.Categorical(objects["name"].to_numpy()[row[stays]])
    write_table(members, part)
    write_layers(objects_path, {"objects": points(objects)}, frame, {"objects": "Point Z"})
    kinds = ", ".join(f"{n} {kind}" for kind, n in objects["kind"].value_counts().items())
    log.info("%d objects (%s); %d removed", len(objects), kinds, len(removed))


def _removed(
    remove: Sequence[str], site: str, objects_path: Path, objects: pd.DataFrame
) -> set[str]:
    """Names of the objects that the site removes.

    Raises
    ------
    InputError : there is no object of such a name.
    """
    known = [str(name) for name in objects["name"]]
    for name in remove:
        if name not in known:
            close = nearest(name, known)
            few = close.startswith("did you mean") or len(known) <= _LISTED
            raise InputError(
                "no object of the scene has this name",
                where=f"site {site}: placement.remove",
                found=name,
                hint=f"{close}; "
                * few
                + f"the {len(known)} objects are named in the layer objects of"
                f" {objects_path} once the site has run without this entry",
            )
    return set(remove)


main = Command(gather_objects)


if __name__ == "__main__":
    sys.exit(main())
