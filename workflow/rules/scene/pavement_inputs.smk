"""Helpers of the pavement rules: which way is taken, and what that way alone uses."""

from roadsight.scene.pavement.choice import (
    FINEST_M,
    MOST_CELLS,
    MOST_SHARPENED,
    choose_method,
)


def pavement_is_given(wildcards):
    """Whether the user gives the monitored area, so that nothing is looked for."""
    return SITES[wildcards.site].site.placement.tma is not None


def stated_method(wildcards):
    """How a site's pavement is found where that is known when the rules are read, else auto."""
    if pavement_is_given(wildcards):
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


def profile_for_pavement(wildcards):
    """The profile, by which the way to the pavement is chosen, or a surface is refused."""
    if stated_method(wildcards) in ("user", "published"):
        return []
    return [f"results/{wildcards.site}/scene/profile.json"]


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
