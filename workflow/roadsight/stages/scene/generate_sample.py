"""Generate the embedded sample: a scanned synthetic site, its truth and digitised edges."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.sections.run import HighwayScene, Run, Sample
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.records.atomic import write_json
from roadsight.io.vector.vectors import write_layers
from roadsight.scene.classes import VEGETATION
from roadsight.stages.command import Command
from roadsight_worlds.highway.airborne_survey import survey
from roadsight_worlds.highway.highway import EPSG, build_highway
from roadsight_worlds.highway.mobile_scanner import PointChunk, scan
from roadsight_worlds.highway.truth import digitised_edges, truth_layers

_FIRST_SECOND_OF_WEEK = 200_000.0
"""When the scan begins, s of the GPS week: some moment on a Tuesday."""

TRUTH_DIMENSION = "truth_class"
"""Extra dimension of the cloud with each point's `TruthClass`: for scoring, never an input."""


def generate_sample(
    scene: HighwayScene,
    length_m: Annotated[float, Sample],
    class_scheme: Annotated[str, Sample],
    seed: Annotated[int, Run],
    *,
    cloud: Annotated[Path, "LAZ to write"],
    truth: Annotated[Path, "GeoPackage to write"],
    edges: Annotated[Path, "GeoJSON to write"],
) -> None:
    """Build the site, scan it and write the three files."""
    highway = build_highway(
        seed, length_m, scene.radius_m, scene.grade, scene.tunnel, scene.overhead
    )
    frame = highway.frame()
    scan_rng, click_rng = np.random.default_rng(seed).spawn(2)
    scanned = survey if scene.scanned_from == "air" else scan
    xyz_m, dims = _cloud(scanned(highway, scene.points, scan_rng))
    if class_scheme == "plants":
        classes = dims[TRUTH_DIMENSION]
        dims["classification"] = np.where(np.isin(classes, VEGETATION), classes, 0).astype(np.uint8)
    write_laz(cloud, xyz_m, frame, dims)
    write_layers(truth, truth_layers(highway), frame)
    write_native_lines(edges, digitised_edges(highway, click_rng), frame, EPSG)
    logging.info("%d points on %g m of road", len(xyz_m), length_m)


def _cloud(chunks: Iterable[PointChunk]) -> tuple[Floats, dict[str, NDArray[Any]]]:
    """Points (n, 3) in local metres and their LAS dimensions; the class stays 0."""
    parts = list(chunks)
    xyz_m = np.concatenate([part.xyz_m for part in parts])
    once = np.ones(len(xyz_m), np.uint8)
    return xyz_m, {
        "intensity": np.concatenate([part.intensity for part in parts]),
        "gps_time": _FIRST_SECOND_OF_WEEK + np.concatenate([part.time_s for part in parts]),
        "point_source_id": np.concatenate([part.sweep for part in parts]),
        "return_number": once,
        "number_of_returns": once,
        TRUTH_DIMENSION: np.concatenate([part.truth_class for part in parts]),
    }


# Lines digitised in the cloud's own CRS, as a user's GIS writes them.

_DECIMALS = 3
"""Of written coordinates in the cloud's unit, a millimetre in metres."""


def write_native_lines(
    path: str | os.PathLike[str], lines: gpd.GeoDataFrame, frame: Frame, epsg: int
) -> None:
    """Write lines as GeoJSON of the 2008 kind: native coordinates and a ``crs`` member.

    The same lines give the same bytes.

    Parameters
    ----------
    lines : LineStrings in local metres with their properties.
    epsg : code of the native CRS, whose unit is the metre.
    """
    features = []
    for row in lines.itertuples(index=False):
        properties = row._asdict()
        vertices = frame.to_native(shapely.get_coordinates(properties.pop("geometry")))
        geometry = {"type": "LineString", "coordinates": np.round(vertices, _DECIMALS).tolist()}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}
    write_json(path, {"type": "FeatureCollection", "crs": crs, "features": features})


main = Command(generate_sample)


if __name__ == "__main__":
    sys.exit(main())
