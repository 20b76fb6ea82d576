"""The machine-readable summary of a site: ``results/<site>/summary.json``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import pandas as pd

from roadsight import __version__
from roadsight.base.doubts import Doubt, by_severity
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.checksums import sha256
from roadsight.io.records.tables import read_about, read_table
from roadsight.poles.drive.videolog import OK
from roadsight.stages.command import run_stage


def summarise_site(arguments: argparse.Namespace) -> None:
    """Write the summary; a job that the site does not ask for is absent."""
    frame = read_json(arguments.frame)
    scores = [read_json(path) for path in arguments.scores]
    summary: dict[str, Any] = {
        "site": arguments.site,
        "version": __version__,
        "seed": arguments.seed,
        "inputs": frame["inputs"] | {path: sha256(path) for path in arguments.given},
        "settings": json.loads(arguments.settings),
        "scene": {
            **read_json(arguments.profile),
            "pavement_scores": scores[0] if scores else None,
            "traffic": read_about(arguments.traffic[0]) if arguments.traffic else None,
        },
        "effects": {effect.pop("effect"): effect for effect in read_json(arguments.effects)},
    }
    for path in arguments.pavement:
        summary["pavement_area_m2"] = read_about(path)["area_m2"]
    if arguments.solutions:
        coverage = read_json(arguments.coverage[0])
        summary["sensors"] = json.loads(arguments.sensors)
        summary["placement"] = {}
        for solution_path, timing_path in zip(arguments.solutions, arguments.timings, strict=True):
            solution = read_json(solution_path) | read_json(timing_path)
            summary["placement"][solution["plan"]] = _plan(solution, coverage["candidates"])
        for path in arguments.data:
            summary["placement"][Path(path).parent.name]["data"] = read_json(path)
        for path in arguments.tolerances:
            found = read_json(path)
            summary["placement"][found["plan"]]["tolerance"] = found
        for path in arguments.removals:
            found = read_json(path)
            own = {"objects": found["objects"], "removals": found["rows"]}
            summary["placement"][found["plan"]] |= own
    if arguments.poles:
        summary["poles"] = _poles(arguments)
    told = [Doubt.from_dict(one) for path in arguments.doubts for one in read_json(path)]
    summary["warnings"] = [doubt.to_dict() for doubt in by_severity(told)]
    write_json(arguments.out, summary)


def _poles(arguments: argparse.Namespace) -> dict[str, Any]:
    """Counts of the pole job at each step, and its scores where poles are known."""
    frames = read_table(arguments.frames, ["status"])
    cameras = pd.concat([read_table(path, ["accepted", "reason"]) for path in arguments.cameras])
    sightings = pd.concat([read_table(path, ["kept", "reason"]) for path in arguments.sightings])
    poles = read_table(arguments.poles, ["kept", "reason"])
    unused = frames.loc[frames["status"] != OK, "status"]
    refused = cameras.loc[~cameras["accepted"].astype(bool), "reason"]
    return {
        "images": len(frames),
        "aligned_images": int(cameras["accepted"].sum()),
        "sightings": int(sightings["kept"].sum()),
        "poles": int(poles["kept"].sum()),
        "withheld": {
            "images": _counts(pd.concat([unused, refused])),
            "sightings": _counts(sightings.loc[~sightings["kept"].astype(bool), "reason"]),
            "poles": _counts(poles.loc[~poles["kept"].astype(bool), "reason"]),
        },
        "validation": read_json(arguments.validation) if arguments.validation else None,
        "cameras": read_json(arguments.camera_scores) if arguments.camera_scores else None,
        **_given_cameras(arguments.cameras),
    }


def _given_cameras(paths: list[str]) -> dict[str, Any]:
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


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "settings", "frame", "profile", "effects", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--sensors", default="{}", help="definitions of the sensors as JSON")
    for name in ("frames", "poles", "validation", "camera-scores"):
        parser.add_argument(f"--{name}", nargs="?")
    shards = ("cameras", "sightings", "solutions", "timings", "data", "tolerances", "removals")
    tables = ("given", "scores", "traffic", "coverage", "pavement", "doubts")
    for name in (*shards, *tables):
        parser.add_argument(f"--{name}", nargs="*", default=[])
    return run_stage(parser, summarise_site, argv)


if __name__ == "__main__":
    sys.exit(main())
