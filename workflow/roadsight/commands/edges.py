"""``roadsight edges``: trace the road edges of a cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import geopandas as gpd

from roadsight.api.scene import edges
from roadsight.base.errors import InputError
from roadsight.commands.pavement import Search
from roadsight.commands.verb import CloudPath, Reading, Verb, check_output, load_cloud
from roadsight.io.vector.vectors import write_layers


def run(
    cloud_path: CloudPath,
    /,
    reading: Reading,
    search: Search,
    *,
    out: Annotated[Path, "GeoPackage to write"],
) -> None:
    """Write layers ``edges`` and ``pavement`` in the cloud's CRS."""
    check_output(out, cloud_path, ".gpkg", read=[search.track])
    search.check()
    cloud = load_cloud(cloud_path, reading)
    road = search.road(cloud)
    try:
        lines = edges(road)
    except InputError as error:
        raise InputError(str(error), where=str(cloud_path)) from error
    parts = list(road.outline.geoms)
    outline = gpd.GeoDataFrame({"area_m2": [part.area for part in parts]}, geometry=parts)
    write_layers(out, {"edges": lines, "pavement": outline}, cloud.frame)
    print(f"{len(lines)} edges, {lines['length_m'].sum():.0f} m: {out}")


VERB = Verb("edges", "trace road edges into a GeoPackage", run)
