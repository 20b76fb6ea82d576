"""Cost and accuracy of one level of a study, measured by the workflow's own rules."""

from __future__ import annotations

import json
import logging
import math
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from roadsight.base.errors import InputError
from roadsight.base.sections.run import Sample
from roadsight.config.load import ResolvedSite, load_config, load_sites, merged
from roadsight.evidence.exact_highway import RCS_M2, TARGET
from roadsight.evidence.metrics import METRICS
from roadsight.evidence.placement_metrics import Results
from roadsight.evidence.tradeoffs import cheapest, stage_costs
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import write_json
from roadsight.placement.sensors.poses import AS_MOUNTED, turns_of
from roadsight.placement.sensors.sensors import AnySensor, Sensor, load_sensors
from roadsight.placement.sight.detection import MIN_BEAMS
from roadsight.stages.command import Command

log = logging.getLogger("measure_tradeoff")


def measure_tradeoff(
    site: str,
    config_json: Annotated[str, "whole configuration, JSON"],
    changes_json: Annotated[str, "settings of the level, JSON"],
    metrics: Sequence[str],
    work: Annotated[str, "folder to work in, deleted afterwards"],
    plan: Annotated[str, "plan to solve, if not the site's first"] = "",
    stages: Annotated[Sequence[str], "rules to time again and again"] = (),
    repeats: Annotated[int, "timings of each of them"] = 2,
    cores: int = 1,
    *,
    out: Path,
) -> None:
    """Run the level, time its stages again, and write costs and accuracies."""
    config = json.loads(config_json)
    changes = json.loads(changes_json)
    if plan:
        config["plans"] = [plan]
    base, _ = _site(config, site, {})
    resolved, sample = _site(config, site, changes)
    plan = next(iter(resolved.plans))
    sensors = _sensors(resolved, config)
    for name in metrics:
        if name not in METRICS:
            raise InputError(
                f"unknown metric {name!r}", where="--metrics", allowed=", ".join(METRICS)
            )
    refuse_other_targets(metrics, resolved.settings.targets.model_dump())
    spinning = resolved.settings.poses.spinning.model_dump()
    refuse_sensors_without_maps(metrics, sensors, spinning)
    read = [target.format(plan=plan) for name in metrics for target in METRICS[name].targets]
    targets = list(dict.fromkeys(read))
    variant = Variant.prepare(".", work, config, site, changes)
    ran = variant.run(targets, cores)
    log.info("ran %s", ", ".join(f"{rule} {count}" for rule, count in ran.items()) or "nothing")
    if not ran and resolved.settings != base.settings:
        raise InputError(
            "no rule behind the metrics uses what this level changes",
            where=f"metric {', '.join(metrics)}",
            found=changes_json,
            hint="measure what the setting changes, or vary another setting",
        )
    records = variant.records(targets)
    costs = stage_costs(records)
    for stage in stages:
        if stage not in costs:
            raise InputError(
                f"is no step of {', '.join(targets)}",
                where=f"stage {stage}",
                allowed=", ".join(costs),
            )
        jobs = [record for record in records if record.rule == stage]
        again = variant.repeat(targets, jobs, repeats - 1, cores)
        costs[stage] = cheapest([costs[stage], *(stage_costs(part)[stage] for part in again)])
    results = Results(
        variant.result(""), Path("results") / site, resolved.settings, sample, plan, sensors
    )
    values = {name: METRICS[name].value(results) for name in metrics}
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            values[name] = None
    write_json(
        out, {"metrics": values, "stages": {rule: asdict(cost) for rule, cost in costs.items()}}
    )
    shutil.rmtree(variant.folder)


def _site(
    config: dict[str, Any], name: str, changes: dict[str, Any]
) -> tuple[ResolvedSite, Sample]:
    """The site at the level's settings, and the scene that it generates."""
    overrides = merged(config["overrides"], changes)
    site = load_sites(load_config(config | {"overrides": overrides}))[name]
    if site.site.sample is None:
        raise InputError("is no generated site, so that its truth is unknown", where=f"site {name}")
    return site, site.site.sample


def _sensors(site: ResolvedSite, config: dict[str, Any]) -> dict[str, AnySensor]:
    """Sensors of the plan that is looked at; none where no sensor is placed."""
    known = load_sensors(config["sensors_file"])
    return {name: known[name] for plan in list(site.plans.values())[:1] for name in plan.sensors}


# Settings at which a metric has no meaning, told before anything runs.

_SEEN_BY = {
    "kind": "cylinder",
    "radius_m": TARGET.radius_m,
    "height_m": TARGET.height_m,
    "min_beams": MIN_BEAMS,
    "rcs_m2": RCS_M2,
}
"""Settings of targets that exact ranges are judged by."""


def refuse_other_targets(metrics: Iterable[str], targets: Mapping[str, Any]) -> None:
    """Check that metrics are asked for whose truth holds for a site's targets.

    Parameters
    ----------
    metrics : names. targets : section ``targets`` of the settings.

    Raises
    ------
    InputError : the truth of one is of the default targets, and these are others.
    """
    judged = [name for name in metrics if METRICS[name].default_targets]
    others = {
        f"targets.{key}": targets[key]
        for key, usual in _SEEN_BY.items()
        if judged and targets[key] != usual
    }
    if others:
        raise InputError(
            "judges the default targets only",
            where=f"metric {', '.join(judged)}",
            found=", ".join(f"{key}: {value}" for key, value in others.items()),
            allowed=", ".join(f"{key}: {_SEEN_BY[key.removeprefix('targets.')]}" for key in others),
            hint="leave these settings out, or measure something else",
        )


def refuse_sensors_without_maps(
    metrics: Iterable[str], sensors: Mapping[str, AnySensor], spinning: Mapping[str, list[float]]
) -> None:
    """Check that a plan has the depth maps that metrics read.

    Parameters
    ----------
    metrics : names. sensors : of the plan. spinning : setting ``poses.spinning``: yaw_deg,
        pitch_deg, roll_deg.

    Raises
    ------
    InputError : no sensor of the plan has depth maps of its own, since all are judged in poses.
    """
    readers = [name for name in metrics if METRICS[name].depth_maps]
    spin = any(isinstance(sensor, Sensor) for sensor in sensors.values())
    if readers and not (spin and turns_of(**spinning) == [AS_MOUNTED]):
        raise InputError(
            "reads depth maps of spinning LiDARs as mounted, and the plan places none",
            where=f"metric {', '.join(readers)}",
            found=", ".join(sensors) + (f" in the poses {dict(spinning)}" if spin else ""),
            hint="name a plan with such a sensor, or measure targets_lost or sensors",
        )


main = Command(measure_tradeoff)


if __name__ == "__main__":
    sys.exit(main())
