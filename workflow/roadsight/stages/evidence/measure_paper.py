"""One run of a site for the page of both studies: what it found and what it cost."""

from __future__ import annotations

import json
import logging
import math
import re
import shutil
import sys
from base64 import b64encode
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.config.load import load_config, load_sites, merged
from roadsight.evidence.tradeoffs import stage_costs
from roadsight.evidence.variants import JobRecord, Variant
from roadsight.geometry.areas import inside
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.depth_maps import NOT_CAST_M, DepthMaps
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.sight.lanes import lanes_abreast, trace_lanes
from roadsight.scene.profile import mean_spacing_m
from roadsight.stages.command import Command

log = logging.getLogger("measure_paper")

_MAP_PX = 900
"""Width of a depth map's picture."""

_SENSOR = re.compile(r"render_depth_maps|build_detection_shard")
"""Steps that work sensor by sensor; their logs lie in a folder of the sensor's name."""


def measure_paper(
    site: str,
    config_json: Annotated[str, "whole configuration, JSON"],
    changes_json: Annotated[str, "settings that differ, JSON"],
    targets: Annotated[Sequence[str], "results to bring up to date"],
    work: Annotated[str, "folder to work in, deleted afterwards"],
    plans: Annotated[Sequence[str], "plans to solve, if not the site's"] = (),
    cores: int = 1,
    *,
    out: Path,
) -> None:
    """Run the site with some settings changed, and write what the tables and figures show."""
    config, changes = json.loads(config_json), json.loads(changes_json)
    overrides = merged(config["overrides"], changes)
    resolved = load_sites(load_config(config | {"overrides": overrides}))[site]
    variant = Variant.prepare(".", work, config, site, changes, plans)
    ran = variant.run(targets, cores)
    log.info("ran %s", ", ".join(f"{rule} {count}" for rule, count in ran.items()) or "nothing")
    records = variant.records(targets)
    sample = resolved.site.sample
    content: dict[str, Any] = {
        "cpu_s": {rule: cost.cpu_s for rule, cost in stage_costs(records).items()},
        "length_km": sample.length_m / 1000 if sample else None,
    }
    folder = variant.result("")
    if "placement" in resolved.site.jobs:
        lane_width_m = resolved.settings.conditions.lane_width_m
        content |= _placement(folder, records, plans, lane_width_m)
    else:
        content |= _poles(folder)
    write_json(out, content)
    shutil.rmtree(variant.folder)


def _placement(
    folder: Path, records: Sequence[JobRecord], plans: Sequence[str], lane_width_m: float
) -> dict[str, Any]:
    """Facts of the site, its pavement, its plans, and the time of a candidate by sensor."""
    scores = folder / "scene/pavement_scores.json"
    maps = sorted((folder / "placement/round-0/depth").glob("*/0.parquet"))
    return {
        "facts": _facts(folder, lane_width_m),
        "pavement": read_json(scores) if scores.is_file() else None,
        "plans": {plan: _plan(folder / f"placement/{plan}/solution.json") for plan in plans},
        "seconds_per_candidate": _seconds_per_candidate(folder, records),
        "maps": {path.parent.name: _picture(path) for path in maps},
    }


def _facts(folder: Path, lane_width_m: float) -> dict[str, float | None]:
    """The site as Table 2 of the placement study describes its own."""
    frame = Frame.from_dict(read_json(folder / "scene/frame.json"))
    edges = read_layer(folder / "placement/edges.gpkg", "edges", frame).geometry
    pavement = read_layer(folder / "scene/pavement.gpkg", "pavement", frame).geometry
    facts = site_facts(
        stack_xyz(CloudTiles(folder / "scene/cloud.parquet").read(("x", "y", "z"))).astype(float),
        list(edges),
        shapely.union_all(pavement.to_numpy()),
        lane_width_m,
    )._asdict()
    return {key: value if math.isfinite(value) else None for key, value in facts.items()}


def _plan(path: Path) -> dict[str, Any]:
    solution = read_json(path)
    sensors = solution["sensors"]
    return {
        "sensors": len(sensors),
        "status": solution["status"],
        "bound": solution["bound"],
        "covered_share": solution["covered_targets"] / solution["targets"],
        "sensors_m": [[one["x"], one["y"], one["z"]] for one in sensors],
    }


def _seconds_per_candidate(folder: Path, records: Sequence[JobRecord]) -> dict[str, float]:
    """Processor time of a depth map with its row of the detection matrix, by sensor."""
    total: dict[str, float] = defaultdict(float)
    for record in records:
        parts = Path(record.log).parts
        if _SENSOR.fullmatch(record.rule) and "round-0" in parts:
            total[parts[parts.index("round-0") + 1]] += record.cpu_s
    candidates = len(read_table(folder / "placement/round-0/candidates.parquet"))
    return {sensor: cpu_s / max(candidates, 1) for sensor, cpu_s in sorted(total.items())}


def _picture(path: Path) -> str:
    """The first depth map of a file as a PNG data URL: near is bright, no return is black.

    Azimuth runs across, high elevation on top; rows of few channels are drawn taller. Beams that
    no target needs are not cast by every model: they are gray.
    """
    _, range_m = next(iter(DepthMaps(path)))
    near = (255 * np.exp(-range_m / 30.0)).astype(np.uint8)
    shade = cv2.applyColorMap(near, cv2.COLORMAP_VIRIDIS)
    shade[range_m <= 0] = 0
    shade[(range_m > 0) & (range_m <= NOT_CAST_M)] = 128
    height = max(len(range_m) * _MAP_PX // max(range_m.shape[1], 1), 64)
    drawn = cv2.resize(shade[::-1], (_MAP_PX, height), interpolation=cv2.INTER_AREA)
    return "data:image/png;base64," + b64encode(cv2.imencode(".png", drawn)[1]).decode()


def _poles(folder: Path) -> dict[str, Any]:
    """Validation, components, counts of voxels and of poles shown, and places for the map."""
    content: dict[str, Any] = {}
    for name in ("validation", "components", "camera_scores"):
        path = folder / f"poles/{name}.json"
        content[name] = read_json(path) if path.is_file() else None
    for name, column in (("voxels", "ix"), ("road_edges", "x")):
        path = folder / f"poles/{name}.parquet"
        content[name] = len(read_table(path, [column])) if path.is_file() else None
    frames = read_table(folder / "poles/frames.parquet", ["image", "x", "y"])
    content["images"] = len(frames["image"].unique())
    content["cameras_m"] = frames[["x", "y"]].dropna().to_numpy().round(2).tolist()
    shards = sorted((folder / "poles/pole_axes").glob("*.parquet"))
    shown = pd.concat([read_table(path, ["image"]) for path in shards] or [pd.DataFrame()])
    content["shown"] = {} if shown.empty else shown["image"].value_counts().sort_index().to_dict()
    poles = folder / "poles/poles.parquet"
    if poles.is_file():
        table = read_table(poles, ["x", "y", "kept"])
        content["poles_m"] = table.loc[table["kept"], ["x", "y"]].to_numpy().round(2).tolist()
    return content


# Facts of a placement site, those of the first study's Table 2.

REACH_M = 30.0
"""Points farther from the road's edges do not count: 20 m at the study's Site 1, else 30 m."""

_EVERY_M = 1.0
"""Spacing of the edge's points through which a circle is laid."""

_STRAIGHT_M = 10_000.0
"""Radii beyond are straight: over 250 m the middle of such an arc is 0.8 m off its chord."""


class SiteFacts(NamedTuple):
    """A row of Table 2.

    Parameters
    ----------
    points : of the cloud, on the road and up to `REACH_M` beside it.
    spacing_m : median distance of these to their nearest neighbours.
    length_m : of the longest edge. width_m : pavement over that length, all carriageways.
    lanes : abreast on the widest road, 0 where none fits. lane_width_m : as given.
    radius_m : of the circle that fits the longest edge best; infinite where it is straight.
    """

    points: int
    spacing_m: float
    length_m: float
    width_m: float
    lanes: int
    lane_width_m: float
    radius_m: float


def site_facts(
    xyz_m: Floats,
    edges: Sequence[shapely.LineString],
    pavement: shapely.MultiPolygon,
    lane_width_m: float,
    reach_m: float = REACH_M,
) -> SiteFacts:
    """Table 2 of a site, computed from its geometry (paper 1, section 3.1).

    Parameters
    ----------
    xyz_m : (n, 3) cloud. edges : of the road. All local metres.

    Raises
    ------
    InputError : there is no edge, or no point near one.
    """
    if not edges:
        raise InputError("has no road edge, along which a site is measured")
    longest = max(edges, key=lambda line: line.length)
    along = shapely.get_coordinates(shapely.segmentize(list(edges), _EVERY_M))
    # The nearest vertex is at most a centimetre farther than the edge, 20 m away.
    away_m, _ = cKDTree(along).query(xyz_m[:, :2], distance_upper_bound=reach_m)
    near = np.isfinite(away_m) | inside(pavement, xyz_m[:, 0], xyz_m[:, 1])
    if not near.any():
        raise InputError("no point of the cloud lies near the road's edges")
    lanes = trace_lanes(list(edges), pavement, lane_width_m)
    return SiteFacts(
        points=int(near.sum()),
        spacing_m=mean_spacing_m(xyz_m[near]),
        length_m=float(longest.length),
        width_m=float(pavement.area / longest.length),
        lanes=int(lanes_abreast(lanes).max()) if len(lanes) else 0,
        lane_width_m=lane_width_m,
        radius_m=radius_of(shapely.get_coordinates(shapely.segmentize(longest, _EVERY_M))),
    )


def radius_of(xy_m: Floats) -> float:
    """Radius of the circle through points (n, 2) by least squares (Kasa 1976); infinite: straight.

    A road that turns both ways has no one radius; the circle is that of its whole course.
    """
    if len(xy_m) < 3:
        return float("inf")
    offset = xy_m - xy_m.mean(axis=0)
    scale = max(float(np.abs(offset).max()), 1e-9)
    x, y = (offset / scale).T
    design = np.column_stack([2 * x, 2 * y, np.ones(len(x))])
    (a, b, c), _, rank, _ = np.linalg.lstsq(design, x * x + y * y, rcond=1e-10)
    radius_m = scale * float(np.sqrt(max(c + a * a + b * b, 0.0)))
    return radius_m if rank == 3 and radius_m <= _STRAIGHT_M else float("inf")


main = Command(measure_paper)


if __name__ == "__main__":
    sys.exit(main())
