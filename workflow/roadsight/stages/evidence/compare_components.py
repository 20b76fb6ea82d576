"""What each component of the pole job is worth: the errors without it (paper 2, Table 1)."""

from __future__ import annotations

import logging
import shlex
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.triangulate.geographic import triangulate_published
from roadsight.poles.triangulate.rays import UNAIDED
from roadsight.stages.command import Command
from roadsight.stages.poles import align_cameras, calibrate_drive, measure_poles, triangulate_poles
from roadsight.stages.poles import validate_poles as validate

log = logging.getLogger("compare_components")

SEEDS = 5
"""Random orders of the published triangulation, whose median counts."""


@dataclass(frozen=True)
class Given:
    """What the stages are run on, as their own command lines take it."""

    frames: str
    image_edges: Annotated[Sequence[str], "shards in order"]
    masks: Annotated[Sequence[str], "shards in order"]
    depth: Annotated[Sequence[str], "shards in order"]
    road_edges: str
    columns: str
    voxels: str
    dem: str
    frame: str
    truth: str
    pole_axes: Annotated[Sequence[str], "shards in order"] = ()
    matches: Annotated[Sequence[str], "shards in order"] = ()
    truth_kind: str | None = None
    truth_crs: str | None = None
    terrain: str | None = None
    baseline: str | None = None
    calibrate: Annotated[str, "options of calibrate_drive, as one text"] = ""
    align: Annotated[str, "options of align_cameras, as one text"] = ""
    measure: Annotated[str, "options of measure_poles, as one text"] = ""
    triangulate: Annotated[str, "options of triangulate_poles, as one text"] = ""


def compare_components(given: Given, *, out: Path) -> None:
    """Run the pole job from the cameras on with all components, and without each of them.

    All runs have the site's own settings but for the component that is left out.
    """
    variants: dict[str, dict[str, str]] = {
        "all": {},
        "lidar_bearing": {"bearing": "image"},
        "alignment": {"method": "none"},
        "occlusion": {"terrain": ""},
        "side_views": {"views": "front"},
        "deterministic_mrf": {"triangulation": "published"},
        "pole_landmarks": {"columns": "", "pole_axes": ""},
        "image_ties": {"matches": ""},
    }
    records = []
    for component, without in variants.items():
        with tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
            records.append({"component": component, **_Variant(given, without, folder).run()})
        log.info("%s", records[-1])
    write_json(out, records)


class _Variant:
    """One run of the stages from calibration to validation in a folder of its own."""

    def __init__(self, given: Given, without: dict[str, str], folder: str) -> None:
        self._given, self._without, self._folder = given, without, Path(folder)

    def run(self) -> dict[str, Any]:
        """Numbers of the variant."""
        frames, axes = self._given.frames, self._given.pole_axes
        if self._without.get("views") == "front":
            frames, axes = self._front_only()
        self._align(frames, axes)
        images = int(read_table(self._path("cameras"), ["accepted"])["accepted"].sum())
        self._measure(frames)
        if self._without.get("triangulation") == "published":
            scores = [self._published(seed) for seed in range(1, SEEDS + 1)]
        else:
            scores = [self._triangulated()]
        medians = pd.DataFrame(scores).median()
        return {"images_accepted": images} | {str(k): _known(v) for k, v in medians.items()}

    def _path(self, name: str, suffix: str = "parquet") -> str:
        return str(self._folder / f"{name}.{suffix}")

    def _front_only(self) -> tuple[str, list[str]]:
        frames = read_table(self._given.frames).assign(left_path="", right_path="")
        write_table(self._path("frames"), frames)
        if not self._given.pole_axes:
            return self._path("frames"), []
        axes = pd.concat([read_table(path) for path in self._given.pole_axes])
        write_table(self._path("axes"), axes[axes["view"] == "front"])
        return self._path("frames"), [self._path("axes")]

    def _align(self, frames: str, axes: Sequence[str]) -> None:
        given = self._given
        shared = [
            *("--frames", frames, "--image-edges", *given.image_edges, "--frame", given.frame),
            *("--road-edges", given.road_edges, "--dem", given.dem),
            *_optional("--terrain", self._without.get("terrain", given.terrain)),
            *_optional("--columns", self._without.get("columns", given.columns if axes else "")),
            *(("--pole-axes", *axes) if "pole_axes" not in self._without else ()),
        ]
        calibration = self._path("calibration", "json")
        tied = [] if "matches" in self._without else ["--matches", *given.matches]
        known = _optional("--baseline", given.baseline)
        options = [*shared, *tied, *known, *shlex.split(given.calibrate)]
        _checked(calibrate_drive.main([*options, "--out", calibration]))
        options = [*shared, *shlex.split(given.align), "--calibration", calibration]
        options += _optional("--method", self._without.get("method"))
        _checked(align_cameras.main([*options, "--out", self._path("cameras")]))

    def _measure(self, frames: str) -> None:
        given = self._given
        bearing = self._without.get("bearing")
        options = [
            *("--frames", frames, "--cameras", self._path("cameras"), *shlex.split(given.measure)),
            *("--dem", given.dem, "--frame", given.frame, *_optional("--bearing", bearing)),
            *_optional("--columns", "" if bearing == "image" else given.columns),
            *_optional("--voxels", given.voxels),
            *("--calibration", self._path("calibration", "json")),
            *("--shards", str(len(given.masks))),
        ]
        for shard, (masks, depth) in enumerate(zip(given.masks, given.depth, strict=True)):
            own = ["--shard", str(shard), "--masks", masks, "--depth", depth]
            out = self._path(f"sightings-{shard}")
            _checked(measure_poles.main([*options, *own, "--out", out]))
        parts = [read_table(self._path(f"sightings-{shard}")) for shard in range(len(given.masks))]
        write_table(self._path("sightings"), pd.concat(parts, ignore_index=True))

    def _triangulated(self) -> dict[str, float]:
        given = self._given
        options = [
            *("--sightings", self._path("sightings"), "--frame", given.frame, "--dem", given.dem),
            *("--voxels", given.voxels, "--layers", self._path("poles", "gpkg")),
            *("--csv", self._path("poles", "csv"), "--geojson", self._path("poles", "geojson")),
            *shlex.split(given.triangulate),
        ]
        _checked(triangulate_poles.main([*options, "--poles", self._path("poles")]))
        return self._scores()

    def _published(self, seed: int) -> dict[str, float]:
        """Poles by the published triangulation in one random order."""
        sightings = read_table(self._path("sightings"))
        named = {
            "latitude": "lat",
            "longitude": "lon",
            "bearing_deg": "bearing",
            "depth_m": "depth",
        }
        kept = sightings[sightings["kept"]].rename(columns=named)
        poles = triangulate_published(kept, UNAIDED, seed)
        frame = Frame.from_dict(read_json(self._given.frame))
        xy = SiteNorth(frame).to_local(poles["lat"], poles["lon"])
        table = pd.DataFrame({"id": [f"p{n}" for n in range(len(xy))], "kept": True})
        table[["x", "y"]] = xy
        write_table(self._path("poles"), table)
        return self._scores()

    def _scores(self) -> dict[str, float]:
        given, out = self._given, self._path("validation", "json")
        options = [
            *("--poles", self._path("poles"), "--truth", given.truth, "--frame", given.frame),
            *("--frames", given.frames, "--edges", given.road_edges),
            *_optional("--truth-kind", given.truth_kind),
            *_optional("--truth-crs", given.truth_crs),
        ]
        _checked(validate.main([*options, "--out", out]))
        found = read_json(out)
        f1 = {row["threshold_m"]: row["f1"] for row in found["thresholds"]}
        values = {"poles": found["poles"], "mean_error_m": found["mean_m"]}
        values |= {"f1_3m": f1.get(3), "f1_6m": f1.get(6)}
        return {name: np.nan if value is None else value for name, value in values.items()}


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _optional(flag: str, value: str | None) -> list[str]:
    return [flag, value] if value else []


def _checked(code: int) -> None:
    if code:
        raise InputError("a variant could not be run", hint="see the message above")


main = Command(compare_components)


if __name__ == "__main__":
    sys.exit(main())
