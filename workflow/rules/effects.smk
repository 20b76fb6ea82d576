"""Which physical effects each site simulates.

Decisions hang on the measured scene, so that `profile_scene` is the one checkpoint of a site. Before
it has run, `snakemake -n` shows inputs that hang on a decision as <TBD>; after it, the whole DAG.

REQUIRED INPUTS  results/{site}/scene/profile.json, frame.json; config/effects.yaml
OUTPUTS          results/{site}/effects.json
"""

from roadsight.effects.catalogue import load_catalogue
from roadsight.effects.circumstances import SETTINGS, Circumstances
from roadsight.effects.planner import plan
from roadsight.io.atomic import read_json
from roadsight.io.videolog_files import side_views_per_image

EFFECTS = clearly(load_catalogue, CONFIG.effects_file)


def circumstances(site):
    """What decisions at a site rest on, beside the measured scene."""
    resolved = SITES[site]
    settings = resolved.settings.model_dump(mode="json", include=SETTINGS)
    sensors = sensors_of(site) if wants(site, "placement") else []
    return {
        "jobs": resolved.site.jobs,
        "modes": resolved.settings.effect_modes,
        "settings": settings,
        "sensors": {name: SENSORS[name].to_dict() for name in sensors},
        "given": given_to_poles(site) if wants(site, "poles") else {},
    }


@lru_cache(maxsize=None)
def given_to_poles(site):
    """What a site gives the pole job beside the cloud."""
    resolved = SITES[site]
    poles = resolved.site.poles
    sides = 2.0
    if not resolved.site.sample:
        images = resolved.beside(poles.images)
        table = resolved.beside(poles.videolog) or images
        sides = clearly(side_views_per_image, table, images)
    return {"camera_poses": False, "distortion_px": 0.0, "side_views": sides}


def circumstances_json(wildcards):
    return json.dumps(circumstances(wildcards.site), sort_keys=True)


@lru_cache(maxsize=None)
def decisions(site, files, changed):
    """Decision on each effect of a site, from the content of its profile and its frame."""
    about = circumstances(site)
    sensors = {name: SENSORS[name] for name in about["sensors"]}
    profile, frame = map(read_json, files)
    measured = Circumstances(profile, frame, about["settings"], sensors, about["given"])
    made = plan(EFFECTS, about["modes"], about["jobs"], measured)
    return {decision.effect: decision.decision for decision in made}


def mode_of(effect, wildcards):
    """Mode of an effect at a site: auto where the measured scene decides."""
    if not wants(wildcards.site, EFFECTS[effect].job):
        return "skip"
    modes = SITES[wildcards.site].settings.effect_modes
    return modes.get(effect, EFFECTS[effect].mode)


def decided(effect, wildcards):
    """Decision on an effect by the profile that there is."""
    mode = mode_of(effect, wildcards)
    if mode != "auto":
        return mode
    scene = Path("results", wildcards.site, "scene")
    files = (str(scene / "profile.json"), str(scene / "frame.json"))
    changed = tuple(os.stat(file).st_mtime_ns for file in files)
    return decisions(wildcards.site, files, changed)[effect]


def only_if(effect, inputs):
    """An input function that gives nothing where a site skips an effect.

    Parameters
    ----------
    inputs : an input function, or a path with wildcards.
    """

    def needed(wildcards):
        after_profile(effect)(wildcards)
        if decided(effect, wildcards) == "skip":
            return []
        return inputs(wildcards) if callable(inputs) else inputs.format(**wildcards)

    return needed


def after_profile(*effects):
    """No input, but what makes a rule wait for the profile where that decides on an effect."""

    def waited(wildcards):
        if any(mode_of(effect, wildcards) == "auto" for effect in effects):
            checkpoints.profile_scene.get(site=wildcards.site)
        return []

    return waited


def decision_on(effect):
    """The decision as a parameter; its rule takes `after_profile` among its inputs."""

    def decision(wildcards):
        # Before the profile is there this is never used: the rule waits for it and is asked again.
        profile = Path("results", wildcards.site, "scene/profile.json")
        known = mode_of(effect, wildcards) != "auto" or profile.exists()
        return decided(effect, wildcards) if known else "open"

    return decision


rule plan_effects:
    input:
        profile="results/{site}/scene/profile.json",
        frame="results/{site}/scene/frame.json",
        catalogue=CONFIG.effects_file,
        code=sources("plan_effects"),
    output:
        effects="results/{site}/effects.json",
    log:
        log_of("plan_effects"),
    benchmark:
        benchmark_of("plan_effects")
    conda:
        ENVIRONMENT
    params:
        circumstances=circumstances_json,
    shell:
        "python -m roadsight.stages.plan_effects --profile {input.profile}"
        " --frame {input.frame} --catalogue {input.catalogue:q}"
        " --circumstances {params.circumstances:q} --out {output.effects} > {log} 2>&1"
