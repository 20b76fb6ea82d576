"""Both whole jobs on the embedded samples, beside the published way and the published times.

The workflow itself is run first, so that nothing is counted that is not up to date; what each step
used is what it wrote at the end of its log. The placement's sample has the size of the placement
paper's second site. Published times of the pole job are core-seconds on its own cluster.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bench_lidar import rendered_hits
from bench_measure import Size, measured, row
from roadsight.evidence.studies import PublishedStage, load_tradeoffs
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json
from roadsight.io.records.run_records import Usage, last_usage
from roadsight.placement.depth.hybrid import hybrid_depth
from roadsight.placement.sensors.sensors import load_sensors

ROOT = Path(__file__).parents[1]
PLACEMENT, POLES = "sample", "sample_rural"
_MILE_M = 1_609.344
_RENDERED = 6
_NOT_THE_JOB = {"generate_sample", "generate_rural", "render_videolog", "write_site_page",
                "write_poles_page", "summarise_site"}  # fmt: skip


def rows(size: Size) -> list[dict[str, Any]]:
    """Rows of both jobs; they have one size, which quick runs leave out."""
    if size == "quick":
        return []
    command = [sys.executable, "-m", "snakemake", "--cores", "2", "--quiet", "all"]
    subprocess.run(command, cwd=ROOT, check=True)
    return [_placement(), *_poles()]


def _usage(site: str) -> dict[str, list[Usage]]:
    """What the jobs of each rule of a site used."""
    found: dict[str, list[Usage]] = {}
    folder = ROOT / "logs" / site
    for log in sorted(folder.rglob("*.log")):
        if (used := last_usage(log)) is not None:
            parts = log.relative_to(folder).with_suffix("").parts
            rule = next(part for part in reversed(parts) if not part[:1].isdigit())
            found.setdefault(rule, []).append(used)
    return found


def _total(used: Mapping[str, Sequence[Usage]]) -> tuple[float, float]:
    """CPU seconds of all jobs and the greatest peak, MiB."""
    jobs = [job for jobs in used.values() for job in jobs]
    return sum(job.cpu_s for job in jobs), max((job.peak_mib for job in jobs), default=0.0)


def _placement() -> dict[str, Any]:
    """Cloud to plans, beside the published depth maps and targets for the same matrix alone."""
    used = {name: jobs for name, jobs in _usage(PLACEMENT).items() if name not in _NOT_THE_JOB}
    cpu_s, peak_mib = _total(used)
    summary = read_json(ROOT / "results" / PLACEMENT / "summary.json")
    plans, sensors = summary["placement"], summary["sensors"]
    proven = np.mean([plan["status"] == "optimal" for plan in plans.values()])
    candidates, targets = (max(plan[key] for plan in plans.values())
                           for key in ("candidates", "targets"))  # fmt: skip
    theirs_s, theirs_mib = _published_way(sensors, candidates, targets)
    return row(
        "placement, cloud to all plans",
        ("the whole job", cpu_s, peak_mib),
        ("detection matrices alone, as published (extrapolated)", theirs_s, theirs_mib),
        (float(proven), f"share of {len(plans)} plans with proof"),
        f"{candidates} candidates x {targets} targets, {len(sensors)} sensors",
    )


def _published_way(
    names: Iterable[str], candidates: int, targets: int
) -> tuple[float, float | None]:
    """CPU seconds of hybrid depth maps and rendered targets at all candidates, by a few of them."""
    scene = ROOT / "results" / PLACEMENT / "scene"
    cloud = stack_xyz(CloudTiles(scene / "cloud.parquet").read(("x", "y", "z")))
    sensors = load_sensors(ROOT / "config" / "sensors.yaml")
    place = pd.read_parquet(ROOT / "results" / PLACEMENT / "placement" / "targets.parquet")
    low = place[["x", "y", "z"]].to_numpy()[:: max(len(place) // _RENDERED, 1)][:_RENDERED]
    position = low.mean(axis=0) + np.array([0.0, 0.0, 6.0])
    total, peak = 0.0, None
    for sensor in (sensors[name] for name in names):
        depth, map_s, peak = measured(
            lambda sensor=sensor: hybrid_depth(cloud, sensor, position, 0.0)
        )
        _, render_s, _ = measured(
            lambda sensor=sensor, depth=depth: rendered_hits(depth, sensor, (position, 0.0), low)
        )
        total += candidates * (map_s + render_s / len(low) * targets)
    return total, peak


def _poles() -> list[dict[str, Any]]:
    """The whole pole job and its published stages, each a mile of road."""
    used = {name: jobs for name, jobs in _usage(POLES).items() if name not in _NOT_THE_JOB}
    frames = pd.read_parquet(ROOT / "results" / POLES / "poles" / "frames.parquet")
    miles = _route_m(frames) / _MILE_M
    stages = load_tradeoffs(ROOT / "config" / "tradeoffs.yaml").published_stages
    images = f"{len(frames)} images, {miles:.2f} miles; a mile of road"
    found = [_stage(stage, used, miles, images) for stage in stages]
    published_s = sum(60 * stage.minutes_per_mile * stage.cores for stage in stages)
    cpu_s, peak_mib = _total(used)
    return [_beside("poles, whole job", cpu_s / miles, peak_mib, published_s, images), *found]


def _stage(
    stage: PublishedStage, used: Mapping[str, Sequence[Usage]], miles: float, work: str
) -> dict[str, Any]:
    cpu_s, peak_mib = _total({rule: used[rule] for rule in stage.rules if rule in used})
    published_s = 60 * stage.minutes_per_mile * stage.cores
    first, *rest = stage.title.split()
    title = " ".join(["poles,", first.lower() if first.istitle() else first, *rest])
    return _beside(title, cpu_s / miles, peak_mib, published_s, work)


def _beside(
    title: str, ours_s: float, ours_mib: float, theirs_s: float, work: str
) -> dict[str, Any]:
    return row(
        title,
        ("the steps that do the same", ours_s, ours_mib),
        ("published, its cores times its time (GPUs not counted)", theirs_s, None),
        (float("nan"), "other roads, images and networks: nothing to agree on"),
        work,
    )


def _route_m(frames: pd.DataFrame) -> float:
    """Length of the routes along the images' places."""
    track = frames.dropna(subset=["x", "y"]).sort_values(["route", "sequence"], kind="stable")
    steps: NDArray[np.float64] = np.hypot(*track.groupby("route")[["x", "y"]].diff().to_numpy().T)
    return float(np.nansum(steps))


if __name__ == "__main__":
    print(json.dumps(rows("usual"), indent=2))
