"""What audits of effects are asked for."""


def audited_sites(job):
    """Sites that ask for an audit of a job."""
    return [
        site
        for site, resolved in SITES.items()
        if resolved.settings.effects == "audit" and wants(site, job)
    ]


def config_of_audit(wildcards):
    """The configuration with the audited site and plan alone."""
    plans = list(plans_of(wildcards.site))[:1]
    changes = {"sites": [str(SITES[wildcards.site].file)], "plans": plans}
    return CONFIG.model_copy(update=changes).model_dump_json()


def effects_of_one_way(wildcards):
    """Effects of the pole job that a site has no choice about: poses that nobody gives."""
    given = SITES[wildcards.site].site.poles.cameras
    return "" if given else "--leave-out road_alignment"


def audited_plan(wildcards):
    return next(iter(plans_of(wildcards.site)))
