"""What each component of the pole job is worth: the errors without it (paper 2, Table 1)."""

from __future__ import annotations

import json
import logging
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pandas as pd

from roadsight.base.section import Section, validated
from roadsight.base.sections.poles import (
    Alignment,
    AlignmentLimits,
    Calibration,
    EdgeTracing,
    Reach,
    Sightings,
    Triangulation,
    Validation,
)
from roadsight.base.shards import Shard
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.images.views import VIEWS, ViewName
from roadsight.poles.triangulate.geographic import triangulate_published
from roadsight.poles.triangulate.rays import UNAIDED
from roadsight.stages.command import Command
from roadsight.stages.poles.align_cameras import align_cameras
from roadsight.stages.poles.calibrate_drive import calibrate_drives
from roadsight.stages.poles.measure_poles import measure_poles
from roadsight.stages.poles.shared.alignment_inputs import SceneFiles
from roadsight.stages.poles.shared.dense_inputs import DenseFiles
from roadsight.stages.poles.triangulate_poles import triangulate_poles
from roadsight.stages.poles.validate_poles import validate_poles

log = logging.getLogger("compare_components")

Part = TypeVar("Part", bound=Section)
SEEDS = 5
"""Random orders of the first study's code, whose median counts."""


class PoleSettings(Section):
    """Settings of the stages that are run."""

    calibration: Calibration
    alignment: Alignment
    sightings: Sightings
    triangulation: Triangulation
    validation: Validation


@dataclass(frozen=True)
class Given:
    """What the stages are run on."""

    frames: Path
    image_edges: Annotated[Sequence[Path], "shards in order"]
    masks: Annotated[Sequence[Path], "shards in order"]
    depth: Annotated[Sequence[Path], "shards in order"]
    road_edges: Path
    columns: Path
    voxels: Path
    dem: Path
    frame: Path
    truth: str
    settings_json: Annotated[str, "settings of the stages, by section, as JSON"]
    pole_axes: Annotated[Sequence[Path], "shards in order"] = ()
    matches: Annotated[Sequence[Path], "shards in order"] = ()
    truth_kind: str | None = None
    truth_crs: str | None = None
    terrain: Path | None = None
    baseline: str | None = None
    views: Sequence[ViewName] = VIEWS
    curvature: Literal["simulate", "skip"] = "skip"
    grid_convergence: Literal["simulate", "skip"] = "simulate"


COMPONENTS = (
    "lidar_bearing",
    "alignment",
    "occlusion",
    "side_views",
    "deterministic_mrf",
    "grouping_by_evidence",
    "pole_landmarks",
    "image_ties",
)
# Components that calibration, cameras and sightings depend on; all else depends on every component.
_OF_CALIBRATION = {"occlusion", "side_views", "pole_landmarks", "image_ties"}
_CHANGED_BY = {
    "calibration": _OF_CALIBRATION,
    "cameras": _OF_CALIBRATION | {"alignment"},
    "sightings": _OF_CALIBRATION | {"alignment", "lidar_bearing"},
}


def compare_components(given: Given, *, out: Path) -> None:
    """Run the pole job from the cameras on with all components, and without each of them.

    All runs have the site's own settings but for the component that is left out. Without grouping
    by evidence, the study's sweep places the poles; without its determinism too, the first code.
    """
    settings = validated(PoleSettings, json.loads(given.settings_json), "settings")
    with tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        records = []
        for component in ("all", *COMPONENTS):
            variant = _Variant(given, settings, component, Path(folder))
            records.append({"component": component, **variant.run()})
            log.info("%s", records[-1])
    write_json(out, records)


class _Variant:
    """One run of the stages from calibration to validation.

    What a component does not change is taken from the runs before: variants share a folder.
    """

    def __init__(self, given: Given, settings: PoleSettings, without: str, folder: Path) -> None:
        self._without, self._folder = without, folder
        self._settings = settings
        if without == "occlusion":
            given = replace(given, terrain=None)
        if without == "image_ties":
            given = replace(given, matches=())
        if without == "pole_landmarks":
            given = replace(given, pole_axes=())
        if without == "side_views":
            frames = read_table(given.frames).assign(left_path="", right_path="")
            write_table(self._path("frames"), frames)
            given = replace(given, frames=self._path("frames"))
            if given.pole_axes:
                axes = pd.concat([read_table(path) for path in given.pole_axes])
                write_table(self._path("axes"), axes[axes["view"] == "front"])
                given = replace(given, pole_axes=(self._path("axes"),))
        self._given = given

    def run(self) -> dict[str, Any]:
        """Numbers of the variant."""
        self._align()
        images = int(read_table(self._path("cameras"), ["accepted"])["accepted"].sum())
        self._measure()
        if self._without == "deterministic_mrf":
            scores = [self._published(seed) for seed in range(1, SEEDS + 1)]
        else:
            scores = [self._triangulated()]
        medians = pd.DataFrame(scores).median()
        known = {str(k): float(v) if np.isfinite(v) else None for k, v in medians.items()}
        return {"images_accepted": images} | known

    def _path(self, name: str, suffix: str = "parquet") -> Path:
        """File of a result, named after the component if the result depends on it."""
        apart = self._without in _CHANGED_BY.get(name.partition("-")[0], COMPONENTS)
        return self._folder / f"{self._without if apart else 'all'}-{name}.{suffix}"

    def _align(self) -> None:
        given, asked = self._given, self._settings.alignment
        files = SceneFiles(
            given.frames,
            given.road_edges,
            given.frame,
            given.image_edges,
            _part(Reach, asked),
            given.terrain,
            given.dem,
            given.curvature,
            given.pole_axes,
            given.columns if given.pole_axes else None,
        )
        calibration, sides = self._path("calibration", "json"), self._settings.sightings
        if not calibration.exists():
            calibrate_drives(
                files,
                DenseFiles(asked.method),
                self._settings.calibration,
                sides.left_yaw_deg,
                sides.right_yaw_deg,
                given.baseline,
                given.matches,
                out=calibration,
            )
        method = DenseFiles("none" if self._without == "alignment" else asked.method)
        limits = _part(AlignmentLimits, asked)
        if not self._path("cameras").exists():
            align_cameras(files, method, limits, calibration, out=self._path("cameras"))

    def _measure(self) -> None:
        if self._path("sightings").exists():
            return
        given, settings = self._given, self._settings.sightings
        if self._without == "lidar_bearing":
            settings = settings.model_copy(update={"bearing": "image"})
        parts = []
        for number, (masks, depth) in enumerate(zip(given.masks, given.depth, strict=True)):
            parts.append(self._path(f"sightings-{number}"))
            measure_poles(
                given.frames,
                self._path("cameras"),
                masks,
                depth,
                given.dem,
                given.frame,
                settings,
                EdgeTracing().min_marking_px,  # no markings are asked for
                columns=None if self._without == "lidar_bearing" else given.columns,
                calibration=self._path("calibration", "json"),
                voxels=given.voxels,
                views=given.views,
                shard=Shard(number, len(given.masks)),
                grid_convergence=given.grid_convergence,
                out=parts[-1],
            )
        sightings = pd.concat([read_table(part) for part in parts], ignore_index=True)
        write_table(self._path("sightings"), sightings)

    def _triangulated(self) -> dict[str, float]:
        given, asked = self._given, self._settings.triangulation
        if self._without == "grouping_by_evidence":
            asked = asked.model_copy(update={"method": "sweep"})
        triangulate_poles(
            (self._path("sightings"),),
            given.frame,
            asked,
            given.dem,
            voxels=given.voxels,
            poles_path=self._path("poles"),
            layers_path=self._path("poles", "gpkg"),
            csv=self._path("poles", "csv"),
            geojson=self._path("poles", "geojson"),
        )
        return self._scores()

    def _published(self, seed: int) -> dict[str, float]:
        """Poles by the first study's code, which visits links in one random order."""
        sightings = read_table(self._path("sightings"))
        named = {
            "latitude": "lat",
            "longitude": "lon",
            "bearing_deg": "bearing",
            "depth_m": "depth",
        }
        kept = sightings[sightings["kept"] & (sightings["kind"] == "pole")].rename(columns=named)
        poles = triangulate_published(kept, UNAIDED, seed)
        frame = Frame.from_dict(read_json(self._given.frame))
        xy = SiteNorth(frame).to_local(poles["lat"], poles["lon"])
        table = pd.DataFrame({"id": [f"p{n}" for n in range(len(xy))], "kept": True})
        table["kind"] = "pole"
        table[["x", "y"]] = xy
        write_table(self._path("poles"), table)
        return self._scores()

    def _scores(self) -> dict[str, float]:
        given, out = self._given, self._path("validation", "json")
        validate_poles(
            self._path("poles"),
            given.truth,
            given.frame,
            given.frames,
            given.road_edges,
            self._settings.validation.reach_m,
            self._settings.validation.match_m,
            self._settings.sightings.kinds,
            given.truth_kind,
            given.truth_crs,
            out=out,
        )
        found = read_json(out)
        f1 = {row["threshold_m"]: row["f1"] for row in found["thresholds"]}
        values = {"poles": found["poles"], "mean_error_m": found["mean_m"]}
        values |= {"f1_3m": f1.get(3), "f1_6m": f1.get(6)}
        return {name: np.nan if value is None else value for name, value in values.items()}


def _part(part: type[Part], whole: Section) -> Part:
    """The settings of a section that are of one of its parts."""
    return part.model_validate(whole.model_dump(include=set(part.model_fields)))


main = Command(compare_components)


if __name__ == "__main__":
    sys.exit(main())
