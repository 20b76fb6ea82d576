"""Helpers of the evidence rules: studies, their levels and the sites that they start from."""

from roadsight.evidence.metrics import METRICS

STUDIES = TRADEOFFS.studies


wildcard_constraints:
    study="|".join(map(re.escape, STUDIES)),
    level=r"\d+",
    job="placement|poles",


def told_doubts(wildcards):
    """Files in which stages tell what their answers rest on; a stage that tells adds its own."""
    return [rules.build_dem.output.doubts.format(site=wildcards.site)]


def level_name(wildcards):
    return list(STUDIES[wildcards.study].levels)[int(wildcards.level)]


def changes_of_level(wildcards):
    study = STUDIES[wildcards.study]
    return clearly(study.changes, level_name(wildcards))


def plan_of_level(wildcards):
    """Plan of a level; empty: the site's first."""
    return STUDIES[wildcards.study].plan(level_name(wildcards))


@lru_cache(maxsize=None)
def site_of_job(job):
    """Name of the site on which a job's studies are measured."""
    return clearly(load_site, TRADEOFFS.sites[job], OWN_PLANS).site.site


def config_of_study(wildcards):
    return config_of_job(STUDIES[wildcards.study].job)


def config_of_job(job):
    """The configuration with the site of a job's studies and its own plans alone.

    Neither the file that names the studies nor plans that this run asks for make a level stale.
    """
    file = type(CONFIG).model_fields["tradeoffs_file"].default
    changes = {"sites": [TRADEOFFS.sites[job]], "tradeoffs_file": file}
    return OWN_PLANS.model_copy(update=changes).model_dump_json()


@lru_cache(maxsize=None)
def targets_of_job(job):
    """Everything that any study of a job reads, below the site's results."""
    plan = next(iter(plans_of(site_of_job(job))), "")
    metrics = [METRICS[m] for s in STUDIES.values() if s.job == job for m in s.metrics]
    targets = dict.fromkeys(target for metric in metrics for target in metric.targets)
    return [target.format(plan=plan) for target in targets]


def base_of_job(job):
    """The same at the site's own settings."""
    return [f"results/{site_of_job(job)}/{target}" for target in targets_of_job(job)]


def base_of_study(wildcards):
    return base_of_job(STUDIES[wildcards.study].job)


def measured_jobs():
    """Jobs that have studies."""
    return list(dict.fromkeys(study.job for study in STUDIES.values()))


def base_costs():
    return [f"results/tradeoffs/base/{job}.json" for job in measured_jobs()]


def measured_levels():
    return [
        f"results/tradeoffs/levels/{name}-{level}.json"
        for name, study in STUDIES.items()
        for level in range(len(study.levels))
    ]


def measured_length_km():
    """Length of the road of the pole job's site."""
    return SITES[site_of_job("poles")].site.sample.length_m / 1000
