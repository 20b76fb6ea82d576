"""The machine-readable summary of a site: ``results/<site>/summary.json``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd

from roadsight import __version__
from roadsight.base.doubts import Doubt, by_severity
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.run_records import run_record
from roadsight.io.records.sources import sha256
from roadsight.io.records.tables import read_about, read_table
from roadsight.poles.drive.videolog import OK
from roadsight.stages.command import Command


@dataclass(frozen=True)
class PoleResults:
    """What the pole job wrote."""

    frames: Path | None = None
    poles: Path | None = None
    validation: Path | None = None
    camera_scores: Path | None = None
    cameras: Sequence[Path] = ()
    sightings: Sequence[Path] = ()


def summarise_site(
    site: str,
    settings: str,
    frame_path: Path,
    profile: Path,
    effects: Path,
    seed: int,
    pole_results: PoleResults,
    sensors: Annotated[str, "definitions of the sensors as JSON"] = "{}",
    solutions: Sequence[Path] = (),
    timings: Sequence[Path] = (),
    data: Sequence[Path] = (),
    tolerances: Sequence[Path] = (),
    removals: Sequence[Path] = (),
    given: Sequence[str] = (),
    scores_paths: Sequence[Path] = (),
    traffic: Sequence[Path] = (),
    coverage_paths: Sequence[Path] = (),
    pavement: Sequence[Path] = (),
    doubts: Sequence[Path] = (),
    benchmarks: Annotated[Sequence[str], "folders with the times of the site's steps"] = (),
    *,
    out: Path,
    run: Annotated[Path, "when, from what code and at what cost the results were made"],
) -> None:
    """Write the summary, and the run beside it; a job that the site does not ask for is absent."""
    frame = read_json(frame_path)
    scores = [read_json(path) for path in scores_paths]
    summary: dict[str, Any] = {
        "site": site,
        "version": __version__,
        "seed": seed,
        "inputs": frame["inputs"] | {path: sha256(path) for path in given},
        "settings": json.loads(settings),
        "scene": {
            **read_json(profile),
            "pavement_scores": scores[0] if scores else None,
            "traffic": read_about(traffic[0]) if traffic else None,
        },
        "effects": {effect.pop("effect"): effect for effect in read_json(effects)},
    }
    for path in pavement:
        summary["pavement_area_m2"] = read_about(path)["area_m2"]
    if solutions:
        coverage = read_json(coverage_paths[0])
        summary["sensors"] = json.loads(sensors)
        summary["placement"] = {}
        for solution_path, timing_path in zip(solutions, timings, strict=True):
            solution = read_json(solution_path) | read_json(timing_path)
            summary["placement"][solution["plan"]] = _plan(solution, coverage["candidates"])
        for path in data:
            summary["placement"][path.parent.name]["data"] = read_json(path)
        for path in tolerances:
            found = read_json(path)
            summary["placement"][found["plan"]]["tolerance"] = found
        for path in removals:
            found = read_json(path)
            own = {"objects": found["objects"], "removals": found["rows"]}
            summary["placement"][found["plan"]] |= own
    if pole_results.frames and pole_results.poles:
        summary["poles"] = _poles(pole_results.frames, pole_results.poles, pole_results)
    told = [Doubt.from_dict(one) for path in doubts for one in read_json(path)]
    summary["warnings"] = [doubt.to_dict() for doubt in by_severity(told)]
    write_json(out, summary)
    write_json(run, {"site": site} | run_record(benchmarks, __version__).to_dict())


def _poles(frames_path: Path, poles_path: Path, found: PoleResults) -> dict[str, Any]:
    """Counts of the pole job at each step, and its scores where poles are known."""
    frames = read_table(frames_path, ["status"])
    cameras = pd.concat([read_table(path, ["accepted", "reason"]) for path in found.cameras])
    sightings = pd.concat([read_table(path, ["kept", "reason"]) for path in found.sightings])
    poles = read_table(poles_path, ["kind", "kept", "reason"])
    kinds = poles.loc[poles["kept"].astype(bool), "kind"]
    unused = frames.loc[frames["status"] != OK, "status"]
    refused = cameras.loc[~cameras["accepted"].astype(bool), "reason"]
    return {
        "images": len(frames),
        "aligned_images": int(cameras["accepted"].sum()),
        "sightings": int(sightings["kept"].sum()),
        "poles": int((kinds == "pole").sum()),
        "objects": dict(sorted(_counts(kinds).items())),
        "withheld": {
            "images": _counts(pd.concat([unused, refused])),
            "sightings": _counts(sightings.loc[~sightings["kept"].astype(bool), "reason"]),
            "poles": _counts(poles.loc[~poles["kept"].astype(bool), "reason"]),
        },
        "validation": read_json(found.validation) if found.validation else None,
        "cameras": read_json(found.camera_scores) if found.camera_scores else None,
        **_given_cameras(found.cameras),
    }


def _given_cameras(paths: Sequence[Path]) -> dict[str, Any]:
    """How cameras that came with the videolog agree with the road, where they did."""
    shards = [read_about(path) for path in paths]
    if not shards or shards[0].get("method") != "given":
        return {}
    checked = [(s["checked_images"], s["agreeing_share"]) for s in shards if s["checked_images"]]
    images = sum(count for count, _ in checked)
    share = sum(count * share for count, share in checked) / images if images else None
    return {"given_cameras": {"checked_images": images, "agreeing_share": share}}


def _counts(reasons: pd.Series) -> dict[str, int]:
    """How often each reason was given."""
    return {str(reason): int(count) for reason, count in reasons.value_counts().items()}


def _plan(solution: dict[str, Any], candidates: int) -> dict[str, Any]:
    return {
        "status": solution["status"],
        "sensors": len(solution["sensors"]),
        "cost": solution["objective"],
        "lower_bound": solution["bound"],
        "gap": solution["gap"],
        "covered_targets": solution["covered_targets"],
        "targets": solution["targets"],
        "candidates": candidates,
        "uncoverable_targets": solution["uncoverable_targets"],
        "seconds_cpu": solution["seconds_cpu"],
        "proven_area_m2": solution.get("proven_area_m2"),
        **({"availability": solution["availability"]} if "availability" in solution else {}),
        **({"second": solution["second"]} if "second" in solution else {}),
        **({"options": _options(solution["options"])} if "options" in solution else {}),
    }


def _options(found: dict[str, Any]) -> dict[str, Any]:
    """What a plan asks for beyond a cover, what was reached, and how far it is proven."""
    alternatives = found.get("alternatives")
    summary = {key: found[key] for key in ("asked", "goal", "weight", "failure")}
    summary["short_targets"] = len(found["short"])
    if "curve" in found:
        summary["curve"] = found["curve"]
    if alternatives:
        kept = ("replaceable", "places", "shared_places", "least_shared_places")
        summary["alternatives"] = {key: alternatives[key] for key in kept}
    return summary


main = Command(summarise_site)


if __name__ == "__main__":
    sys.exit(main())
