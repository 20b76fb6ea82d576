"""Helpers of the scene rules: decisions on effects, and which way to the pavement is taken."""

from roadsight.effects.catalogue import load_catalogue, plan
from roadsight.effects.quantities import SETTINGS, Circumstances
from roadsight.io.images.camera_tables import read_baselines
from roadsight.io.images.videolog_files import posed_share
from roadsight.io.records.atomic import read_json
from roadsight.placement.sensors.sensors import define_sensor
from roadsight.scene.pavement.choice import FINEST_M, MOST_CELLS, MOST_SHARPENED, choose_method
from snakemake.exceptions import IncompleteCheckpointException

EFFECTS = clearly(load_catalogue, CONFIG.effects_file)


def circumstances(site):
    """What decisions at a site rest on, beside the measured scene."""
    resolved = SITES[site]
    settings = resolved.settings.model_dump(mode="json", include=SETTINGS)
    sensors = sensors_of(site) if wants(site, "placement") else []
    settings["targets"]["min_beams"] = min_beams_of(site)
    return {
        "jobs": resolved.site.jobs,
        "modes": resolved.settings.effect_modes,
        "settings": settings,
        "sensors": {name: sensor_as_used(site, name) for name in sensors},
        "given": given_to_poles(site) if wants(site, "poles") else {},
    }


def sensor_as_used(site, name):
    """Definition of a sensor with the pixels that a site asks of cameras."""
    pixels = min_pixels_of(site) if kind_of(name) == "camera" else None
    asked = {} if pixels is None else {"min_pixels": pixels}
    return what_it_sees(SENSORS[name]) | asked


@lru_cache(maxsize=None)
def given_to_poles(site):
    """What a site gives the pole job beside the cloud."""
    resolved = SITES[site]
    poles = resolved.site.poles
    baseline = resolved.beside(poles.baseline)
    return {
        "posed_share": posed_share_of(resolved),
        "lenses": lenses_of(poles),
        "baseline": clearly(read_baselines, baseline) if baseline else {},
    }


def posed_share_of(resolved):
    """Share of the images whose camera the site gives."""
    poles = resolved.site.poles
    if not poles.cameras:
        return 0.0
    if poles.cameras == "sample":
        return 1.0
    images = resolved.beside(poles.images)
    table = resolved.beside(poles.videolog) or images
    return clearly(posed_share, table, images, resolved.beside(poles.cameras))


@lru_cache(maxsize=None)
def decisions(site, job, files, changed):
    """Decision on each effect of a job at a site, from the content of what was measured."""
    about = circumstances(site)
    sensors = {name: define_sensor(asked, name) for name, asked in about["sensors"].items()}
    profile, frame, *drive = map(read_json, files)
    measured = Circumstances(profile, frame, about["settings"], sensors, about["given"], *drive)
    made = plan(EFFECTS, about["modes"], [job], measured)
    return {decision.effect: decision.decision for decision in made}


def measured_files(job, site):
    """What decisions on a job's effects rest on."""
    files = ["scene/profile.json", "scene/frame.json"]
    files += ["poles/drive.json"] if job == "poles" else []
    return tuple(f"results/{site}/{file}" for file in files)


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
    job = EFFECTS[effect].job
    files = measured_files(job, wildcards.site)
    changed = tuple(os.stat(file).st_mtime_ns for file in files)
    return decisions(wildcards.site, job, files, changed)[effect]


def only_if(effect, inputs):
    """An input function that gives nothing where a site skips an effect.

    Parameters
    ----------
    inputs : an input function, a path with wildcards, or a list of them.
    """

    def needed(wildcards):
        await_profile(effect, wildcards)
        return [] if decided(effect, wildcards) == "skip" else value_at(wildcards, inputs)

    return needed


@lru_cache(maxsize=None)
def unfinished(job, site, finished):
    """What Snakemake says while the profile of a job is not there; None once it is.

    Parameters
    ----------
    finished : number of files that checkpoints have made; the answer holds until there are more.
    """
    measured = checkpoints.profile_drive if job == "poles" else checkpoints.profile_scene
    try:
        measured.get(site=site)
    except IncompleteCheckpointException as waiting:
        return waiting
    return None


def awaited(effect, wildcards):
    """The same of the profile that decides on an effect, if one does.

    A dry run lists what a stale profile would have: it would end at the profile otherwise.
    """
    if mode_of(effect, wildcards) != "auto":
        return None
    measured = measured_files(EFFECTS[effect].job, wildcards.site)
    if workflow.dryrun and all(map(os.path.exists, measured)):
        return None
    finished = len(checkpoints.created_output)
    return unfinished(EFFECTS[effect].job, wildcards.site, finished)


def await_profile(effect, wildcards):
    """Go on only once there is the profile that decides on an effect, if one does."""
    waiting = awaited(effect, wildcards)
    if waiting is not None:
        raise waiting.with_traceback(None)


def after_profile(*effects):
    """The profile that a rule waits for while it decides on an effect; nothing once it is there.

    Snakemake makes a job anew whose last input function raises: here that is half of all jobs.
    """

    def waited(wildcards):
        first = next(filter(None, (awaited(effect, wildcards) for effect in effects)), None)
        return [first.targetfile] if first else []

    return waited


def decision_on(effect):
    """The decision as a parameter; its rule takes `after_profile` among its inputs."""

    def decision(wildcards):
        # Before the profile is there this is never used: the rule waits for it and is asked again.
        files = measured_files(EFFECTS[effect].job, wildcards.site)
        known = mode_of(effect, wildcards) != "auto" or all(map(os.path.exists, files))
        return decided(effect, wildcards) if known else "open"

    return decision


def stated_method(wildcards):
    """How a site's pavement is found where that is known when the rules are read, else auto."""
    if SITES[wildcards.site].site.placement.tma is not None:  # nothing is looked for
        return "user"
    return SITES[wildcards.site].setting("pavement.method")


def method_by_profile(wildcards):
    """How it is found, by the profile that there is."""
    stated = stated_method(wildcards)
    if stated != "auto":
        return stated
    seeded = bool(SITES[wildcards.site].setting("pavement.seeds"))
    profile = read_json(f"results/{wildcards.site}/scene/profile.json")
    return clearly(choose_method, stated, seeded, profile).method


def pavement_method(wildcards):
    """The same for inputs: where the profile decides, they wait for it."""
    if stated_method(wildcards) == "auto":
        checkpoints.profile_scene.get(site=wildcards.site)
    return method_by_profile(wildcards)


def of_pavement(method, inputs):
    """Inputs of one way to the pavement; nothing where it is found in another."""
    return where(lambda wildcards: pavement_method(wildcards) == method)(inputs)


def setting_of_pavement(method, value):
    """A parameter that is empty where the pavement is found in another way."""

    def used(wildcards):
        # Before the profile is there this is never used: the rule waits for it and is asked again.
        profile = f"results/{wildcards.site}/scene/profile.json"
        if stated_method(wildcards) == "auto" and not os.path.exists(profile):
            return "open"
        return value(wildcards) if method_by_profile(wildcards) == method else ""

    return used


@where
def if_profiled(wildcards):
    """The profile tells which way to the pavement is chosen, or a surface is refused."""
    return stated_method(wildcards) not in ("user", "published")


def pavement_seeds(wildcards):
    """Places on the road as ``x,y;x,y``."""
    seeds = SITES[wildcards.site].setting("pavement.seeds")
    return ";".join(f"{x!r},{y!r}" for x, y in seeds)


def memory_of_pavement(wildcards, input, attempt):
    """Memory to extract pavement: of a surface, with its cells; more with each attempt."""
    published = megabytes(100)(wildcards, input, attempt)
    profile = list(input.profile)
    if not profile or not os.path.exists(profile[0]):
        return published
    east_m, north_m = read_json(profile[0])["extent_m"][:2]
    most = MOST_SHARPENED if input.clusters else MOST_CELLS
    cells = min(east_m * north_m / FINEST_M**2, most)
    return published + int(attempt * (200 * million_points(input) + cells / 1e6 * 400))
