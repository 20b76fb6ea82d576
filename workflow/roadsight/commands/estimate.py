"""``roadsight estimate``: what a run needs, before anyone starts it."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from roadsight.api.costs import A_MILE, runs_of
from roadsight.base.errors import InputError
from roadsight.base.texts import read_yaml
from roadsight.commands.verb import Verb
from roadsight.config.load import ResolvedSite, load_config, load_site
from roadsight.evidence.costs import Amounts
from roadsight.evidence.estimate import (
    SHIPPED,
    Estimate,
    estimate,
    fit_costs,
    read_costs,
    write_costs,
)
from roadsight.io.cloud.clouds import read_extent, read_header
from roadsight.io.cloud.las_header import CloudHeader
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import write_json

log = logging.getLogger("roadsight")
# A million times this is the largest number that any option takes; what is larger is a slip.
_MOST_MILES = 1e7
_MILE_M = 1609.344  # an international mile
# A degree on a sphere of the Earth's mean radius, for clouds in degrees. Along a parallel it is
# shorter, which an estimate can bear.
_DEGREE_M = 111_195.0


Job = Literal["placement", "poles"]


@dataclass(frozen=True)
class Asked:
    """The runs that an estimate is about."""

    miles: Annotated[float | None, "length of road, instead of sites"] = None
    run_miles: Annotated[float, "road of one run, miles"] = 10.0
    job: Annotated[tuple[Job, ...], "jobs to do; of a site those that it asks for"] = ()
    points_m: Annotated[float | None, "points, millions, of one run"] = None
    candidates: Annotated[float | None, "sensor positions, of one run"] = None
    targets: Annotated[float | None, "targets, of one run"] = None
    images: Annotated[float | None, "images, of one run"] = None
    sensors: Annotated[int | None, "kinds of sensor"] = None
    plans: Annotated[int | None, "plans"] = None
    shards: Annotated[int | None, "shards"] = None
    cores: Annotated[int, "cores at one time"] = 2


def run(
    sites: Annotated[Sequence[str], "sites of config/sites, by name or by file"] = (),
    /,
    *,
    asked: Asked,
    costs: Annotated[Path, "cost model, JSON"] = SHIPPED,
    fit: Annotated[Sequence[Path], "fit a cost model on finished results/<site> folders"] = (),
    out: Annotated[Path | None, "JSON file to write"] = None,
) -> None:
    """Print the estimate, or fit a cost model.

    Raises
    ------
    InputError : neither sites nor miles nor results, or one of them cannot be used.
    """
    table = read_costs(costs)
    if fit:
        if out is None:
            raise InputError("needs -o, the JSON file to write", where="--fit")
        fitted = fit_costs(fit, table.dag)
        write_costs(out, fitted)
        for site, ratio in fitted["held_out"]["predicted_by_actual"].items():
            log.info("%s, held out: predicted by actual processor time %.2f", site, ratio)
        return
    _check(sites, asked)
    names = ("points_m", "candidates", "targets", "images", "sensors", "plans", "shards")
    stated = {name: getattr(asked, name) for name in names if getattr(asked, name) is not None}
    wanted: list[tuple[str, Amounts, Sequence[str], int]] = []  # name, of a run, jobs, runs
    if asked.miles is not None:
        runs, amounts = runs_of(asked.miles, asked.run_miles, stated)
        wanted.append(("road", amounts, asked.job or ("placement", "poles"), runs))
    for name in sites:
        site = load_site(name, load_config(read_yaml("config/config.yaml")))
        jobs = asked.job or [job for job in site.site.jobs if job != "scene"]
        wanted.append((site.site.site, replace(_amounts(site), **stated), jobs, 1))
    found = [
        (name, amounts, estimate(table, amounts, tuple(jobs), runs, asked.cores))
        for name, amounts, jobs, runs in wanted
    ]
    factor = table.factor if math.isfinite(table.factor) else None
    content = []
    for name, amounts, result in found:
        print(_text(name, amounts, result, table.factor))
        totals = {key: getattr(result, key) for key in ("core_h", "jobs", "peak_mib")}
        about = {"name": name, "amounts_a_run": asdict(amounts), "factor": factor}
        content.append({**about, **asdict(result), **totals})
    if out:
        write_json(out, content)


def _check(sites: Sequence[str], asked: Asked) -> None:
    if bool(sites) == (asked.miles is not None):
        raise InputError("give either sites or --miles", where="roadsight estimate")
    for name, value in vars(asked).items():
        if name == "job":
            continue
        least = 0.0 if name in ("points_m", "candidates", "targets", "images") else 1e-6
        if value is not None and not least <= value <= _MOST_MILES * 1e6:
            raise InputError(
                "is no usable number",
                where=f"--{name.replace('_', '-')}",
                found=value,
                allowed=f"{least:g} or more",
            )


def _amounts(site: ResolvedSite) -> Amounts:
    """What can be told before anything runs; candidates and targets as on a road so long."""
    sample = site.site.sample
    if sample is None:
        headers = [read_header(cloud) for cloud in site.clouds]
        points_m, length_m = sum(h.points for h in headers) / 1e6, _length_m(headers)
    else:
        length_m = sample.length_m
        points_m = (sample.points if sample.scene == "highway" else 3_200 * length_m) / 1e6
    images: float = 0
    if "poles" in site.site.jobs:
        images = 0.45 * length_m
        if not sample:
            images = len(ImageSource(site.beside(site.site.poles.images) or "").names())
    miles = length_m / _MILE_M
    sensors = {name for plan in site.plans.values() for name in plan.sensors}
    return Amounts(
        points_m=points_m,
        candidates=A_MILE.candidates * miles,
        sensors=len(sensors),
        targets=A_MILE.targets * miles,
        plans=len(site.plans),
        images=images,
        shards=site.settings.shards,
        rounds=site.setting("coverage.rounds") + 1,
    )


def _length_m(clouds: Sequence[CloudHeader]) -> float:
    """Diagonal of the clouds' common extent in plan, which is a straight road's length."""
    corners = np.array([read_extent(cloud.path) for cloud in clouds])
    low, high = corners[:, 0, :2].min(axis=0), corners[:, 1, :2].max(axis=0)
    crs = clouds[0].stated.crs
    if crs is None:
        return float(np.hypot(*(high - low)))
    unit_m = _DEGREE_M if crs.is_geographic else crs.axis_info[0].unit_conversion_factor
    return float(np.hypot(*(high - low)) * unit_m)


def _text(name: str, amounts: Amounts, result: Estimate, factor: float) -> str:
    """Table for people."""
    rows = [
        f"{s.step:24}{s.jobs:>10,}{s.core_h:>13,.2f}{s.job_s:>11,.0f}{s.peak_mib:>11,.0f}"
        for s in result.steps
    ]
    given = ", ".join(f"{k} {v:,.6g}" for k, v in asdict(amounts).items())
    total = (
        f"{'together':24}{result.jobs:>10,}{result.core_h:>13,.2f}{'':11}{result.peak_mib:>11,.0f}"
    )
    dag = f"{result.jobs_a_run:,} jobs a run: {result.dag_s:,.0f} s, {result.dag_mib:,.0f} MiB"
    return "\n".join(
        [
            f"{name}: {result.runs:,} run(s) of {given}",
            f"{'step':24}{'jobs':>10}{'core-hours':>13}{'s a job':>11}{'MiB a job':>11}",
            *rows,
            total,
            f"{result.wall_h:,.2f} h on {result.cores} cores",
            f"{result.storage_gib:,.1f} GiB of results; the DAG of {dag}",
            f"processor time within a factor of {factor:.2f} on two of three sites held out"
            if math.isfinite(factor)
            else "how far it is off is not known: it rests on one site",
        ]
    )


VERB = Verb("estimate", "core-hours, memory, storage of runs to come", run)
