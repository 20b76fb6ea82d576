"""Helpers of all other files: resolved settings, stage sources, and what each site asks for."""

import importlib.util
import inspect
import json
import os
import re
import shlex
import sys
from functools import lru_cache, partial
from itertools import chain
from operator import attrgetter
from pathlib import Path

from roadsight.config.environment import prepare_environment
from roadsight.config.load import check_engines, load_config, load_site, load_sites, merged
from roadsight.evidence.paper import site_files
from roadsight.evidence.studies import load_evidence_sites, load_tradeoffs
from roadsight.effects.catalogue import load_audit_sites
from roadsight.base.errors import InputError
from roadsight.io.records.sources import CachedChecksums, Stamps, stage_module
from roadsight.io.records.companions import with_companions
from roadsight.base.texts import read_yaml
from roadsight.placement.sensors.sensors import load_sensors
from snakemake.io import strip_wildcard_constraints
from snakemake_logger_plugin_roadsight.producers import remember_producers
from snakemake_logger_plugin_roadsight.stopping import let_stops_through

prepare_environment()
let_stops_through()
remember_producers()

LOCK = "envs/requirements.lock"
OPEN3D_LOCK = "envs/requirements-open3d.lock"
PAPER_ASSETS = ["workflow/roadsight/report/assets/paper/report.typ"]
REPORT_ASSETS = sorted(
    {str(path) for path in Path("workflow/roadsight/report/assets").rglob("*.*")}
    - set(PAPER_ASSETS)
)
ENVIRONMENT = "../../../envs/roadsight.yaml"


def clearly(function, *arguments):
    """Call; bad input ends the run with its one message and nothing else."""
    try:
        return function(*arguments)
    except InputError as error:
        sys.stderr.write(f"roadsight: {error}\n")
        sys.stderr.flush()
        os._exit(2)


def refuse(message, **about):
    """End the run with this message."""

    def refused():
        raise InputError(message, **about)

    clearly(refused)


# Snakemake keeps the last of keys that are there twice; reading the files refuses them.
for path in workflow.configfiles:
    clearly(read_yaml, path)
CONFIG = clearly(load_config, config)
ASKED_SITES = clearly(load_sites, CONFIG)
# Conda environments bring Open3D with them, whatever this interpreter has.
BRINGS_OPEN3D = bool(workflow.deployment_settings.deployment_method)
if not BRINGS_OPEN3D:
    clearly(check_engines, ASKED_SITES)
TRADEOFFS = clearly(load_tradeoffs, CONFIG.tradeoffs_file, BRINGS_OPEN3D or None)
# Sites of trade-offs, of audits and of the studies have rules like any other, but only the targets
# `tradeoffs`, `audit` and `paper` ask for them. They solve their own plans, whatever plans a run asks for.
OWN_PLANS = CONFIG.model_copy(update={"plans": []})
AUDIT_SITES = clearly(load_audit_sites, CONFIG.effects_file)
OTHER_SITES = OWN_PLANS.model_copy(update={"sites": [*AUDIT_SITES, *site_files()]})
SITES = (
    clearly(load_evidence_sites, CONFIG, TRADEOFFS) | clearly(load_sites, OTHER_SITES) | ASKED_SITES
)
SENSORS = clearly(load_sensors, CONFIG.sensors_file)
STAMPS = Stamps(Path(".snakemake/roadsight/sources"), LOCK)
CHECKSUMS = CachedChecksums(".snakemake/roadsight/checksums.json")


wildcard_constraints:
    site="|".join(map(re.escape, SITES)),
    plan=r"[a-z0-9_-]+",
    sensor=r"[A-Za-z0-9_.-]+",
    round=r"\d+",
    shard=r"\d+",


# Inputs that a stage waits for and is not told of: its sources, decisions, results that others read.
# So is every input whose name ends with `_files`: what the stage is told of it is a setting.
AWAITED = {"code", "decided", "assets"}
STEP = "RAYON_NUM_THREADS={threads} python -m {params.command} {params.settings} > {log} 2>&1"


def command(wildcards, input, output, threads, told_threads=""):
    """The stage with all that it reads and writes; its name is that of the stamp of its sources.

    Snakemake does not compare a parameter that takes inputs or outputs, as this one does.
    """
    code = input.code if isinstance(input.code, str) else input.code[0]
    read = {
        name: files
        for name, files in input.items()
        if name not in AWAITED and not name.endswith("_files")
    }
    if told_threads:
        read[told_threads] = threads
    return f"{stage_module(Path(code).name)} {as_options(read | dict(output.items()))}"


def command_with(name):
    """The same for a stage that is told its threads, under this name."""
    return partial(command, told_threads=name)


def told(*sections, **values):
    """Settings of a stage as options, in one parameter, which Snakemake compares.

    Parameters
    ----------
    sections : names of those that the stage takes whole; functions of wildcards that give options.
    values : by the names of the stage's parameters, or functions of wildcards that give them.
    """
    parts = [flags(part) if isinstance(part, str) else part for part in sections]

    def options(wildcards):
        named = {name: value_at(wildcards, value) for name, value in values.items()}
        return " ".join([*(part(wildcards) for part in parts), as_options(named)])

    return options


def wildcard(name):
    return lambda wildcards: wildcards[name]


def value_at(wildcards, value):
    """A value, a path with its wildcards filled in, or what a function of wildcards gives."""
    if callable(value):
        return value(wildcards)
    return value.format_map(dict(wildcards.items())) if isinstance(value, str) else value


def of_site(function):
    """A function of a site for a rule: of its wildcards."""
    return lambda wildcards: function(wildcards.site)


def setting(path):
    """Value of a setting at the wildcards' site."""
    return lambda wildcards: SITES[wildcards.site].setting(path)


# What a stage that does one shard of all images is told.
ONE_SHARD = {"shard": wildcard("shard"), "shards": setting("shards")}


def flags(section, *asked):
    """Options of a section: of all its settings, or of those asked for by name or by a part of it."""
    return options_of(setting(section), asked)


def sample_flags(*asked):
    """The same of what a site says of its generated scene."""
    return options_of(site_field("sample"), asked)


def options_of(values_of, asked):
    """Options of what a function of wildcards gives: of all of it, or of what is asked for."""

    def options(wildcards):
        values = values_of(wildcards).model_dump()
        parts = [[part] if isinstance(part, str) else part.model_fields for part in asked]
        return as_options({name: values[name] for name in [*chain(*parts)] or values})

    return options


def settings_of(*sections):
    """Settings of sections as JSON, for a rule whose options would share names."""
    return lambda wildcards: json.dumps(
        {name: setting(name)(wildcards).model_dump() for name in sections}
    )


def as_options(values):
    """Options for a shell; those of a list take its items, and may have none.

    A number may begin with a minus, which argparse must not take apart.
    """
    parts = []
    for name, value in values.items():
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            parts.append(f"{option}={shlex.quote('' if value is None else str(value))}")
        else:
            parts.append(shlex.join([option, *map(str, value)]))
    return " ".join(parts)


def stated(path, wildcards):
    """Value of a site file's field."""
    return attrgetter(path)(SITES[wildcards.site].site)


def site_field(path):
    """The same as a parameter, empty where there is none."""

    def value(wildcards):
        content = stated(path, wildcards)
        return "" if content is None else content

    return value


@lru_cache(maxsize=None)
def sources(stage):
    """What stands for the sources that a stage imports and the lock: an edit makes it stale."""
    return STAMPS.of(stage)


def sources_with(stage, engine):
    """The same, and the lock of Open3D where ``engine``, of wildcards, hands it a step."""
    # Now, and not for the first job that asks: Snakemake lists a folder once.
    own, both = [sources(stage)], [sources(stage), OPEN3D_LOCK]
    return lambda wildcards: both if engine(wildcards) == "open3d" else own


def cloud_files(wildcards):
    """The site's clouds: the user's files, which only their content can make stale."""
    resolved = SITES[wildcards.site]
    if resolved.site.sample:
        return [f"results/{wildcards.site}/sample/cloud.laz"]
    for file in resolved.clouds:
        if not Path(file).is_file():
            refuse("no such cloud", where=f"{resolved.file}: clouds", found=file)
    return ancient(resolved.clouds)


def beside_site(path):
    """Optional file that the site file names, as a list of inputs: with all of a shapefile."""

    def files(wildcards):
        found = SITES[wildcards.site].beside(stated(path, wildcards))
        return [] if found is None else with_companions(found)

    return files


def sample_or_beside(path, generated, where_stated=False):
    """The same, or a file of a generated site's sample, of some only where the site states it."""

    def files(wildcards):
        if (stated(path, wildcards) == "sample") if where_stated else is_rendered(wildcards):
            return [f"results/{wildcards.site}/sample/{generated}"]
        return beside_site(path)(wildcards)

    return files


def layered_site(path, otherwise=None):
    """The same as an argument of a stage: with the layer that the site file names."""

    def files(wildcards):
        content = stated(path, wildcards)
        if content is None or content == "sample":
            return (otherwise or beside_site(path))(wildcards)
        return [SITES[wildcards.site].layered(content)]

    return files


def million_points(input):
    """Size of a stage's cloud in million points; 4 where there is none yet."""
    cloud = getattr(input, "cloud", None)
    if cloud and not isinstance(cloud, str):
        cloud = cloud[0]  # of a step that reads it for some settings only
    return os.path.getsize(cloud) / 9 / 1e6 if cloud and os.path.exists(cloud) else 4


def by_points(base, per_million_points):
    """An amount that grows with the cloud of a stage, and with each attempt."""
    return lambda wildcards, input, attempt: int(
        (base + per_million_points * million_points(input)) * attempt
    )


def megabytes(per_million_points):
    """Memory for a stage that holds the cloud: calibrated on logs."""
    return by_points(600, per_million_points)


# Minutes for a stage that works through the cloud: ten times what a slow core needs.
MINUTES = by_points(30, 5)


def holding_cloud(megabytes_per_million_points):
    """Memory and time of a stage that holds the cloud."""
    return {"mem_mb": megabytes(megabytes_per_million_points), "runtime": MINUTES}


def each_attempt(amount):
    """An amount that grows with each attempt."""
    return lambda wildcards, attempt: amount * attempt


def non_empty(path):
    """An output that is there but empty is a failure."""
    return ensure(path, non_empty=True)


def wants(site, job):
    return job in SITES[site].site.jobs


def sites_with_scene(scene):
    """Pattern of the sites that generate this scene; one that matches nothing if there are none."""
    samples = {name: resolved.site.sample for name, resolved in SITES.items()}
    found = [name for name, sample in samples.items() if sample and sample.scene == scene]
    return "|".join(map(re.escape, found)) or "(?!)"


def where(holds):
    """Maker of inputs that a rule has where something holds of its wildcards, and none elsewhere.

    They are given as an input function, as a path or as a list of paths. A parameter that is
    limited may be something else elsewhere.
    """
    return lambda inputs, otherwise=[]: (
        lambda wildcards: value_at(wildcards, inputs if holds(wildcards) else otherwise)
    )


placement_only = where(lambda wildcards: wants(wildcards.site, "placement"))
poles_only = where(lambda wildcards: wants(wildcards.site, "poles"))
if_rendered = where(lambda wildcards: is_rendered(wildcards))
scene_page_only = where(lambda wildcards: has_scene_page(wildcards.site))


def has_scene_page(site):
    """Whether pavement and edges are among what the site asks for."""
    return wants(site, "scene") or wants(site, "placement")


def asked(results, *jobs):
    """Results of the sites that a run asks for: of those with any of the jobs, or of all."""
    return [
        result.replace("{site}", site)
        for site in ASKED_SITES
        if not jobs or any(wants(site, job) for job in jobs)
        for result in results
    ]


def evidence_pages():
    """``title=path`` of the pages of evidence that there are, relative to the report.

    They are parameters of the report and not inputs: a report would otherwise run hours of sweeps
    again whenever a page is older than the code.
    """
    pages = {
        "Accuracy and time": "tradeoffs/index.html",
        "Real roads": "truth/index.html",
        "Hard cases": "hardcases/index.html",
        "Effects audited": "audit/index.html",
        "Both studies": "paper/short.html",
        "Benchmarks": "bench/index.html",
    }
    return [f"{title}={page}" for title, page in pages.items() if Path("results", page).is_file()]


def printed_reports():
    """The sites' reports on paper; without the engine that sets them, this is said and no more."""
    if importlib.util.find_spec("typst") is None:
        print("no report.pdf: the package typst is not installed", file=sys.stderr)
        return []
    return asked(["results/{site}/report.pdf"])


def handovers():
    """What GIS, CAD and crews take along."""
    found = []
    for site in ASKED_SITES:
        found += [f"results/{site}/gis/{site}.{kind}" for kind in ("gpkg", "qgs", "kml", "dxf")]
        found += [f"results/{site}/stakeout.csv"] if wants(site, "placement") else []
    return found


def site_extent(wildcards):
    """The site's extent as ``kind=value``; a polygon is given by its file."""
    extent = stated("extent", wildcards)
    if extent is None:
        return ""
    kind, _, value = extent.stated.partition("=")
    return f"{kind}={SITES[wildcards.site].layered(value) if kind == 'polygon' else value}"


def extent_crs(wildcards):
    """CRS of the extent's file if it names none."""
    site = SITES[wildcards.site].site
    if site.extent is None:
        return ""
    return (site.extent.polygon_crs if site.extent.polygon else site.placement.edges_crs) or ""


def extent_files(wildcards):
    """Files that decide what belongs to the site: its polygon, edges, or videolog."""
    extent = stated("extent", wildcards)
    if extent is None or extent.box is not None:
        return []
    if extent.polygon is not None:
        return beside_site("extent.polygon")(wildcards)
    return (edges_file if extent.edges_m else videolog_file)(wildcards)


def layered_extent_files(wildcards):
    """The edges or the videolog that decide, with the layer that the site file names."""
    extent = stated("extent", wildcards)
    if extent is not None and extent.edges_m:
        return layered_site("placement.edges", edges_file)(wildcards)
    return extent_files(wildcards)


edges_file = sample_or_beside("placement.edges", "edges.geojson", where_stated=True)
pavement_truth = sample_or_beside("truth.pavement", "truth.gpkg")
pavement_scores = scene_page_only(
    where(pavement_truth)(["results/{site}/scene/pavement_scores.json"])
)


def given_files(wildcards):
    """Files that the user gave beside the clouds."""
    files = []
    if has_scene_page(wildcards.site):
        files += [edges_file, beside_site("placement.tma"), pavement_truth]
    if wants(wildcards.site, "poles"):
        files += [videolog_file, beside_site("poles.baseline"), cameras_of_videolog, known_poles]
        files += [beside_site(f"roads.{name}") for name in ("inventory", "routes", "barriers")]
    return [file for named in files for file in named(wildcards)]


def complete_steps():
    """Give each step what follows from its name: its sources, and its log and benchmark file.

    Plans, rounds, sensors and shards are folders of both, as in the path of the first output. A
    step that names its log itself has the benchmark file of the same name.
    """
    unmoved = workflow.modifier.path_modifier
    for step in workflow.rules:
        if step.shellcmd != STEP:
            continue
        step.input_modifier = step.log_modifier = step.benchmark_modifier = unmoved
        if not step.output:  # what all others are made from
            step.set_log("logs/step.log")
            continue
        if "code" not in step.input.keys():
            step.set_input(code=sources(step.name))
        if not step.log:
            _, place, *parts = Path(strip_wildcard_constraints(step.output[0])).parts
            varied = [part for part in parts if "{" in part.replace("{site}", "")]
            folders = [part.partition(".")[0] for part in varied]
            step.set_log(str(Path("logs", place, *folders, f"{step.name}.log")))
        _, *folders, name = Path(step.log[0]).with_suffix(".tsv").parts
        step.benchmark = str(Path("results", *folders[:1], "benchmarks", *folders[1:], name))


def state_parameters():
    """Write at each function of the rules what it takes, where Python looks for it first.

    Snakemake asks for that three times whenever it calls one: a sixth of the time to list 20,000 jobs.
    """
    for each in workflow.rules:
        asked = [getattr(value, "_evaluator", None) for value in each.resources.values()]
        for given in [*each.input, *each.params, *asked]:
            file = getattr(given, "_file", given)
            function = getattr(file, "callable", None) or file
            if inspect.isfunction(function):
                function.__signature__ = inspect.signature(function)
