"""The files of a site that people open, with their sizes and what opens them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

KINDS = (
    ("report.pdf", "the report on paper", "any PDF reader"),
    ("stakeout.csv", "where to set the sensors", "a spreadsheet, a total station"),
    ("gis/*.qgs", "all layers, grouped and styled", "QGIS"),
    ("gis/*.gpkg", "all layers in one file", "QGIS, ArcGIS, geopandas"),
    ("gis/*.kml", "sensors, poles and road on an online map", "Google Earth and other online maps"),
    ("gis/*.dxf", "drawing with layers, blocks and texts", "any CAD"),
    ("scene/dem.tif", "terrain model; band 2 marks measured cells", "any GIS"),
    ("scene/pavement.gpkg", "pavement", "any GIS"),
    ("placement/edges.gpkg", "road edges", "any GIS"),
    ("placement/unexamined.gpkg", "pavement for which nothing is proven", "any GIS"),
    ("placement/*/solution.gpkg", "sensors and targets of a plan", "any GIS"),
    ("placement/*/solution.json", "solution of a plan with its bound", "programs"),
    ("placement/*/obstacles.gpkg", "what stands in the way", "any GIS"),
    ("placement/objects.gpkg", "objects of the scene by their names", "any GIS"),
    ("placement/*/removals.json", "objects in the way, and sensors saved without them", "programs"),
    ("placement/*/data.json", "hand-over, data rates and margins of a plan", "programs"),
    ("placement/*/data.gpkg", "hand-over and data of a plan's sensors", "any GIS"),
    ("placement/*/tolerance.gpkg", "targets that a sensor's small changes lose", "any GIS"),
    ("placement/*/tolerance.json", "what small changes of a sensor lose", "programs"),
    ("placement/round-*/candidates.parquet", "candidates", "programs (pandas)"),
    ("placement/*/scans.laz", "what the sensors would see", "CloudCompare, QGIS"),
    ("poles/poles.gpkg", "poles, their hazard, cross-sections, road geometry", "any GIS"),
    ("poles/poles.csv", "poles", "a spreadsheet"),
    ("poles/poles.geojson", "poles", "any GIS, web maps"),
    ("poles/placed.gpkg", "poles, sight lines and ellipses before hazard was rated", "any GIS"),
    ("poles/top.tif", "class, height and share of road of the highest voxels", "any GIS"),
    ("poles/pictures.zip", "a picture of each pole", "any picture viewer"),
    ("poles/hazard.csv", "hazard of the poles", "a spreadsheet"),
    ("poles/road_geometry.csv", "radius, grade, cross-slope, width by station", "a spreadsheet"),
    ("poles/road_edges.gpkg", "edges of the road in the LiDAR", "any GIS"),
    ("scene/frame.json", "reference system, local origin, inputs, contradictions", "programs"),
    ("run.json", "when, from what code and in what time it was computed", "programs"),
    ("effects.json", "effects simulated or skipped, and why", "programs"),
    ("summary.json", "all of it in numbers", "programs"),
)
"""Pattern within the site's folder, what it holds, what opens it."""
_STEPS = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


@dataclass(frozen=True)
class ResultFile:
    """One file. path : from the report. size : for people. about, opens : words."""

    path: str
    size: str
    about: str
    opens: str


def result_files(results: Path, site: str) -> Sequence[ResultFile]:
    """Files of a site that there are, in the order of `KINDS`.

    Parameters
    ----------
    results : folder in which the report and the sites' folders lie.
    """
    return [
        ResultFile(str(path.relative_to(results)), size_text(path.stat().st_size), about, opens)
        for pattern, about, opens in KINDS
        for path in sorted((results / site).glob(pattern))
    ]


def size_text(size: int) -> str:
    """Bytes as people say them: ``12 kB``, ``3.4 MB``."""
    for step, unit in _STEPS:
        if size >= step:
            value = size / step
            return f"{value:.0f} {unit}" if value >= 10 else f"{value:.1f} {unit}"
    return f"{size} bytes"
