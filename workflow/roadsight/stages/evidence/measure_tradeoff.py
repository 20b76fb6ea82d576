"""Cost and accuracy of one level of a study, measured by the workflow's own rules."""

from __future__ import annotations

import argparse
import json
import logging
import math
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from roadsight.base.errors import InputError
from roadsight.config.load import ResolvedSite, load_config, load_sites, merged
from roadsight.evidence.metrics import METRICS
from roadsight.evidence.refusals import refuse_other_targets, refuse_sensors_without_maps
from roadsight.evidence.results import Results
from roadsight.evidence.tradeoffs import as_json, cheapest, stage_costs
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import write_json
from roadsight.placement.sensors.sensors import AnySensor, load_sensors
from roadsight.stages.command import run_stage

log = logging.getLogger("measure_tradeoff")


def measure_tradeoff(arguments: argparse.Namespace) -> None:
    """Run the level, time its stages again, and write costs and accuracies."""
    config = json.loads(arguments.config)
    changes = json.loads(arguments.changes)
    if arguments.plan:
        config["plans"] = [arguments.plan]
    site = _site(config, arguments.site, changes)
    sensors = _sensors(site, config)
    refuse_other_targets(arguments.metrics, site.settings.targets.model_dump())
    spinning = site.settings.poses.spinning.model_dump()
    refuse_sensors_without_maps(arguments.metrics, sensors, spinning)
    targets = _targets(arguments.metrics, site)
    variant = Variant.prepare(".", arguments.work, config, arguments.site, changes)
    ran = variant.run(targets, arguments.cores)
    log.info("ran %s", ", ".join(f"{rule} {count}" for rule, count in ran.items()) or "nothing")
    records = variant.records(targets)
    costs = stage_costs(records)
    for stage in arguments.stages:
        if stage not in costs:
            raise InputError(
                f"is no step of {', '.join(targets)}",
                where=f"stage {stage}",
                allowed=", ".join(costs),
            )
        jobs = [record for record in records if record.rule == stage]
        again = variant.repeat(targets, jobs, arguments.repeats - 1, arguments.cores)
        costs[stage] = cheapest([costs[stage], *(stage_costs(part)[stage] for part in again)])
    results = _results(variant, site, sensors)
    values = {name: METRICS[name].value(results) for name in arguments.metrics}
    known = {name: _known(value) for name, value in values.items()}
    write_json(arguments.out, {"metrics": known, "stages": as_json(costs)})
    shutil.rmtree(variant.folder)


def _known(value: Any) -> Any:
    """A number that is one; other values are lists, which stay."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _site(config: dict[str, Any], name: str, changes: dict[str, Any]) -> ResolvedSite:
    """The site at the level's settings."""
    overrides = merged(config["overrides"], changes)
    site = load_sites(load_config(config | {"overrides": overrides}))[name]
    if site.site.sample is None:
        raise InputError("is no generated site, so that its truth is unknown", where=f"site {name}")
    return site


def _targets(metrics: Sequence[str], site: ResolvedSite) -> list[str]:
    """Results that the metrics read."""
    plan = next(iter(site.plans))
    named = [target.format(plan=plan) for metric in metrics for target in METRICS[metric].targets]
    return list(dict.fromkeys(named))


def _sensors(site: ResolvedSite, config: dict[str, Any]) -> dict[str, AnySensor]:
    """Sensors of the plan that is looked at; none where no sensor is placed."""
    known = load_sensors(config["sensors_file"])
    return {name: known[name] for plan in list(site.plans.values())[:1] for name in plan.sensors}


def _results(variant: Variant, site: ResolvedSite, sensors: dict[str, AnySensor]) -> Results:
    sample = site.site.sample
    return Results(
        variant.result(""),
        Path("results") / variant.site,
        site.settings.seed,
        0.0 if sample is None else sample.length_m,
        next(iter(site.plans)),
        sensors,
        site.settings.lidar.azimuth_stride,
    )


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", required=True)
    parser.add_argument("--config", required=True, help="whole configuration, JSON")
    parser.add_argument("--changes", required=True, help="settings of the level, JSON")
    parser.add_argument("--plan", default="", help="plan to solve, if not the site's first")
    parser.add_argument("--metrics", nargs="+", choices=list(METRICS), required=True)
    parser.add_argument("--stages", nargs="*", default=[], help="rules to time again and again")
    parser.add_argument("--repeats", type=int, default=2, help="timings of each of them")
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--work", required=True, help="folder to work in, deleted afterwards")
    parser.add_argument("--out", required=True)
    return run_stage(parser, measure_tradeoff, argv)


if __name__ == "__main__":
    sys.exit(main())
