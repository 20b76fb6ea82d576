"""Road edges that carry candidates: digitised by the user, or traced on the pavement."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import geopandas as gpd
import numpy as np
import shapely
from shapely import LineString, MultiPolygon

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Edges
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_layer, read_lines, write_layers
from roadsight.scene.splines import FURTHEST_M, outline_edges, spline_line
from roadsight.stages.command import Command

log = logging.getLogger("build_edges")


def build_edges(
    site: str,
    frame_path: Path,
    pavement_path: Path,
    dem: Path,
    settings: Edges,
    digitised: Annotated[str | None, "digitised edges, any vector format"] = None,
    digitised_crs: Annotated[str | None, "their CRS if the file names none"] = None,
    *,
    out: Path,
) -> None:
    """Write the edges as splines, marked digitised or automatic."""
    about = read_json(frame_path)
    frame = Frame.from_dict(about)
    layer = read_layer(pavement_path, "pavement", frame)
    pavement = MultiPolygon(list(layer.geometry))
    if digitised:
        lines = read_lines(digitised, frame, digitised_crs)
        tell_near(log, "edges", lines.geometry.to_numpy(), about, digitised)
        named = zip(lines["edge"], lines["kind"], lines.geometry, strict=True)
        edges = [(str(name), str(kind), line) for name, kind, line in named]
        for name, _, line in edges:
            away_m = line.distance(pavement)
            if away_m > FURTHEST_M:
                raise InputError(
                    f"edge {name!r} lies outside the cloud's road",
                    where=digitised,
                    found=f"{away_m:.0f} m from the pavement",
                    allowed=f"at most {FURTHEST_M:.0f} m",
                    hint="check the file's CRS (placement.edges_crs)",
                )
    else:
        found = outline_edges(pavement, _measured_ground(read_raster(dem, frame)), settings)
        edges = [(f"{kind[0]}{n:02d}", kind, line) for n, (kind, line) in enumerate(found)]
    if not edges:
        raise InputError(
            "no edge long enough to carry candidates was found on the pavement outline",
            where=f"site {site}",
            hint="digitise edges and name them in placement.edges",
        )
    splines = [spline_line(line) for _, _, line in edges]
    if not digitised:
        splines = [_moved_off(line, pavement, settings.offset_m) for line in splines]
    table = gpd.GeoDataFrame(
        {
            "edge": [name for name, _, _ in edges],
            "kind": [kind for _, kind, _ in edges],
            "source": "digitised" if digitised else "automatic",
            "length_m": [line.length for line in splines],
        },
        geometry=splines,
    )
    log.info("%d %s edges, %.0f m", len(table), table["source"][0], table["length_m"].sum())
    write_layers(out, {"edges": table}, frame)


def _measured_ground(dem: Raster) -> Floats:
    """Places (k, 3) of the terrain model that hold ground points, by which open ends are told."""
    known = np.isfinite(dem.values) if dem.measured is None else dem.measured
    row, column = np.nonzero(known)
    x = dem.west_m + (column + 0.5) * dem.cell_size_m
    y = dem.north_m - (row + 0.5) * dem.cell_size_m
    return np.column_stack([x, y, dem.values[row, column]])


def _moved_off(line: LineString, pavement: MultiPolygon, offset_m: float) -> LineString:
    """Parallel of an automatic edge off the pavement; the edge itself where there is no room."""
    if offset_m == 0:
        return line
    moved = [shapely.offset_curve(line, sign * offset_m) for sign in (1, -1)]
    off = min(moved, key=lambda curve: curve.intersection(pavement).length / max(curve.length, 1))
    longest = max(shapely.get_parts(off), key=lambda part: part.length, default=line)
    return longest if longest.length > 0.5 * line.length else line


main = Command(build_edges)


if __name__ == "__main__":
    sys.exit(main())
