"""Helpers of the rules of both studies: their runs, and the sites that they start from."""

from roadsight.evidence import paper
from roadsight.evidence.studies import load_overrides


wildcard_constraints:
    size="short|long",
    run=r"[a-z0-9_]+-[a-z0-9_]+",


def run_of_paper(wildcards):
    return paper.runs(wildcards.size)[wildcards.run]


def site_of_paper(wildcards):
    return paper.site_name(run_of_paper(wildcards).site, wildcards.size)


def base_of_paper(wildcards):
    """What the default run of a site makes; the other runs share it."""
    runs = paper.runs(wildcards.size)
    default = runs[f"{runs[wildcards.run].site}-default"]
    return [f"results/{site_of_paper(wildcards)}/{target}" for target in default.targets]


def config_of_paper(wildcards):
    """The configuration with this site alone, whatever this run asks for."""
    file = paper.site_file(run_of_paper(wildcards).site, wildcards.size)
    return OWN_PLANS.model_copy(update={"sites": [file]}).model_dump_json()


def changes_of_paper(wildcards):
    """Settings of the published studies where the run has them, then the run's own."""
    run = run_of_paper(wildcards)
    named = clearly(load_overrides, paper.PUBLISHED_FILE) if run.published else {}
    return merged(named, run.changes)


def runs_of_paper(wildcards):
    return [f"results/paper/runs/{wildcards.size}/{run}.json" for run in paper.runs(wildcards.size)]
