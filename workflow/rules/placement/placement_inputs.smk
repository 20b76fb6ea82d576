"""Helpers of the placement rules: plans, sensors, rounds and shards, targets, poses."""

from roadsight.base.section import check_path
from roadsight.placement.sensors.light import wavelength_nm
from roadsight.placement.sensors.poses import AS_MOUNTED, turns_of
from roadsight.placement.sensors.sensors import AimedSensor, panorama_name, what_it_sees
from roadsight.placement.sight.kinds import Box, room_for, shape_of
from roadsight.placement.sight.probability import Curve

TILTS_OF_ROUND = "results/{site}/placement/round-{round}/tilts.parquet"


def plans_of(site):
    return SITES[site].plans


def plan_of(wildcards):
    return plans_of(wildcards.site)[wildcards.plan]


def sensors_of(site):
    """Sensors of all the site's plans, without repeats, in order of first use."""
    return list(dict.fromkeys(s for plan in plans_of(site).values() for s in plan.sensors))


def mounting_rules(wildcards):
    """Rules of mounting as JSON."""
    return SITES[wildcards.site].settings.mounting.model_dump_json()


@where
def in_last_round(wildcards):
    """Only the last coverage check looks at zones and rules: they come after all detections.

    Rounds before it find gaps of all candidates, so that a zone renders nothing.
    """
    return int(wildcards.round) == rounds_of(wildcards.site)[-1]


def placement_results():
    return [
        f"results/{site}/placement/{plan}/{file}"
        for site in ASKED_SITES
        if wants(site, "placement")
        for plan in plans_of(site)
        for file in ("solution.json", "obstacles.gpkg", "scans.laz")
    ]


def sensor_definition(wildcards):
    """What the sensors file says of the rule's sensor, without its cost: prices render nothing."""
    return what_it_sees(SENSORS[wildcards.sensor])


def rounds_of(site):
    """Numbers of the rounds: 0 is the regular spacing, each later one is denser near gaps."""
    return range(SITES[site].setting("coverage.rounds") + 1)


def shards_in(site, round_number):
    settings = SITES[site].settings
    return settings.shards if round_number == 0 else settings.coverage.shards


def candidates_in(site, rounds):
    return [f"results/{site}/placement/round-{number}/candidates.parquet" for number in rounds]


def detections_in(site, rounds, sensors):
    return [
        f"results/{site}/placement/round-{number}/{kind}/{sensor}/{shard}.parquet"
        for number in rounds
        for sensor in sensors
        for kind in ["poses" if is_posed(site, sensor) else "detection"]
        for shard in range(shards_in(site, number))
    ]


all_candidates = of_site(lambda site: candidates_in(site, rounds_of(site)))
all_detections = of_site(lambda site: detections_in(site, rounds_of(site), sensors_of(site)))


def last_coverage(wildcards):
    last = rounds_of(wildcards.site)[-1]
    return f"results/{wildcards.site}/placement/round-{last}/coverage.json"


def plan_detections(wildcards):
    return detections_in(wildcards.site, rounds_of(wildcards.site), plan_of(wildcards).sensors)


def plan_depth_maps(wildcards):
    """Depth maps of all rounds by which the plan's sensors are judged."""
    site = wildcards.site
    maps = [
        panorama_of(site) if is_posed(site, name) else name for name in plan_of(wildcards).sensors
    ]
    return [
        f"results/{site}/placement/round-{number}/depth/{name}/{shard}.parquet"
        for number in rounds_of(site)
        for name in dict.fromkeys(maps)
        for shard in range(shards_in(site, number))
    ]


def plan_costs(wildcards):
    """``name=cost`` of each sensor of the plan."""
    return [f"{name}={SENSORS[name].cost!r}" for name in plan_of(wildcards).sensors]


def plan_file(option):
    """File that an option of the plan names, as a list of inputs."""
    layered = layered_plan_file(option)
    return lambda wildcards: [file for path in layered(wildcards) for file in with_companions(path)]


def layered_plan_file(option):
    """The same as an argument: with the layer that the plan names."""

    return lambda wildcards: list(filter(None, [plan_of(wildcards).file_of(option)]))


def plan_sensors(wildcards):
    """``plan=sensor,sensor`` for each plan of the site."""
    return [f"{name}={','.join(p.sensors)}" for name, p in plans_of(wildcards.site).items()]


def per_plan(file):
    return lambda wildcards: [
        f"results/{wildcards.site}/placement/{plan}/{file}" for plan in plans_of(wildcards.site)
    ]


def placement_doubts(wildcards):
    """Files in which the placement stages tell what their answers rest on."""
    folder = f"results/{wildcards.site}/doubts"
    plans = [f"{folder}/solve_cover/{plan}.json" for plan in plans_of(wildcards.site)]
    return [f"{folder}/place_candidates.json", f"{folder}/place_targets.json", *plans]


# Points of passing vehicles, where the site asks to clear them.
if_cleared = where(lambda wildcards: setting("lidar.clear_below_m")(wildcards) > 0)
traffic_mask = if_cleared(["results/{site}/scene/traffic.parquet"])


def site_sensors(wildcards):
    """Definitions of all sensors that the site's plans may place."""
    return {name: SENSORS[name].to_dict() for name in sensors_of(wildcards.site)}


def site_sensors_seeing(wildcards):
    """The same without their costs."""
    return {name: what_it_sees(SENSORS[name]) for name in sensors_of(wildcards.site)}


def optical_names(wildcards):
    """The site's LiDARs and cameras, which weather blinds."""
    return [name for name in sensors_of(wildcards.site) if kind_of(name) != "radar"]


def sensor_wavelengths(wildcards):
    """``sensor=wavelength`` of each LiDAR and camera that the site's plans may place."""
    return [f"{n}={wavelength_nm(SENSORS[n]):g}" for n in optical_names(wildcards)]


def lidar_model(wildcards):
    """Model of the depth maps: without its filling, the hybrid model is the preliminary one."""
    model = SITES[wildcards.site].setting("lidar.model")
    fills = model == "hybrid" and decision_on("hole_filling")(wildcards)
    return "preliminary" if fills == "skip" else model


def depth_network(wildcards):
    """Network of the depth maps, where they need one."""
    lidar = SITES[wildcards.site].settings.lidar
    if not lidar.model.startswith("unet"):
        return []
    clearly(check_path, Path(lidar.network), "lidar.network")
    if not Path(lidar.network).is_file():
        refuse(
            "no such file",
            where="lidar.network",
            found=lidar.network,
            hint="see docs/placement/depth-maps.md",
        )
    return [lidar.network]


tilts_of_all_rounds = of_site(lambda s: expand(TILTS_OF_ROUND, site=s, round=rounds_of(s)))


def placement_effect(effect, file):
    """A file of ``placement/effects``, where its effect is simulated."""
    return only_if(effect, [f"results/{{site}}/placement/effects/{file}"])


# Of a plan whose sensors together must see targets so often.
past_traffic = where(lambda wildcards: plan_of(wildcards).availability is not None)
if_robust = where(lambda wildcards: plan_of(wildcards).robust is not None)
if_cells = where(lambda wildcards: setting("obstacles.method")(wildcards) == "cells")


def seen_surfels(wildcards):
    """Surfels of the scene that sensors look at, without the objects that the site removes."""
    resolved = SITES[wildcards.site]
    if resolved.site.placement.remove:
        if resolved.settings.lidar.model != "surfel":
            refuse(
                "objects can only be removed from surfels",
                where=f"{resolved.file}: placement.remove",
                found=f"lidar.model: {resolved.settings.lidar.model}",
                allowed="lidar.model: surfel",
            )
        return f"results/{wildcards.site}/placement/surfels_left.parquet"
    return f"results/{wildcards.site}/scene/surfels.parquet"


def air_of_site(wildcards):
    """What rain and fog take out of beams, where they are simulated."""
    files = []
    for effect in ("rain", "fog"):
        # The one that waits for the profile does not hide the one that a site decides itself.
        waited = after_profile(effect)(wildcards)
        files += waited or placement_effect(effect, f"{effect}.json")(wildcards)
    return files


def cell_arguments(wildcards):
    """Arguments of obstacles by cells, as in the first study."""
    found = SITES[wildcards.site].settings
    if box_of(wildcards.site) is not None:
        refuse(
            "obstacles by cells are for cylinders, the first study's targets",
            where=f"site {wildcards.site}: obstacles.method",
            found=f"targets.kind: {found.targets.kind}",
            hint="set obstacles.method: sight_lines, or targets.kind: cylinder",
        )
    return (
        f"--method cells --target-radius-m {found.targets.radius_m}"
        f" --azimuth-stride {found.lidar.azimuth_stride}"
        f" --curvature {decision_on('curvature_refraction')(wildcards)}"
    )


def change_arguments(wildcards):
    """How targets are seen, and how far sensors may stand from their plan, as arguments."""
    found = SITES[wildcards.site].settings
    return (
        f"{flags('tolerance')(wildcards)} --radius-m {found.targets.radius_m}"
        f" --height-m {target_height(wildcards)} {target_box(wildcards)}"
        f" --min-beams {min_beams_of(wildcards.site)}"
        f" --azimuth-stride {found.lidar.azimuth_stride} --engine {found.lidar.engine}"
    )


def robust_arguments(wildcards):
    """Arguments of a cover that holds with tolerance."""
    posed = [s for s in plan_of(wildcards).sensors if is_posed(wildcards.site, s)]
    if posed:
        refuse(
            "robust: tolerance is for spinning LiDARs as mounted",
            where=f"site {wildcards.site}, plan {wildcards.plan}",
            found=", ".join(posed),
            hint="leave robust or these sensors out",
        )
    effects = (
        f" --partial-hits {decision_on('partial_hits')(wildcards)}"
        f" --curvature {decision_on('curvature_refraction')(wildcards)}"
    )
    return f"--robust --sensors-file {CONFIG.sensors_file} {change_arguments(wildcards)}{effects}"


def box_of(site):
    """The box that targets of a site are; None for cylinders."""
    shape = shape_of(SITES[site].settings.targets.model_dump())
    return shape if isinstance(shape, Box) else None


def target_box(wildcards):
    """Size of boxes as arguments; nothing for cylinders."""
    box = box_of(wildcards.site)
    return "" if box is None else f"--box {box.length_m} {box.width_m} {box.height_m}"


def target_room(wildcards):
    """Radius and height about each target in which beams are cast."""
    return list(room_for(shape_of(SITES[wildcards.site].settings.targets.model_dump())))


def target_height(wildcards):
    box = box_of(wildcards.site)
    return setting("targets.height_m")(wildcards) if box is None else box.height_m


def min_beams_of(site):
    """More beams than this must return from a target of a site."""
    targets = SITES[site].settings.targets
    if targets.min_probability == 0:
        return targets.min_beams
    return Curve(*targets.lidar_curve).needed(targets.min_probability) - 1


def min_pixels_of(site):
    """Pixels that cameras of a site need of a target; None: what their definitions say."""
    targets = SITES[site].settings.targets
    if targets.min_probability == 0:
        return None
    return Curve(*targets.camera_curve).needed(targets.min_probability)


def edges_of_targets(wildcards):
    """Edges along which targets stand, where they are boxes, or that bound the road."""
    site = SITES[wildcards.site].site
    needed = box_of(wildcards.site) is not None or site.placement.edges is not None
    return [f"results/{wildcards.site}/placement/edges.gpkg"] if needed else []


def target_width(wildcards):
    """Width of a target, whatever its kind: the lesser side of a box."""
    box = box_of(wildcards.site)
    targets = SITES[wildcards.site].settings.targets
    return 2 * targets.radius_m if box is None else min(box.length_m, box.width_m)


def kind_of(sensor):
    return SENSORS[sensor].to_dict()["kind"]


def is_posed(site, sensor):
    """Whether a sensor is judged in poses: all aimed ones, and spinning ones that are turned."""
    if isinstance(SENSORS[sensor], AimedSensor):
        return True
    grid = SITES[site].settings.poses.spinning
    return turns_of(grid.yaw_deg, grid.pitch_deg, grid.roll_deg) != [AS_MOUNTED]


@lru_cache(maxsize=None)
def panorama_of(site):
    """Name of the panorama that serves all posed sensors of a site."""
    ranges = [SENSORS[s].range_m for s in sensors_of(site) if is_posed(site, s)]
    return panorama_name(SITES[site].settings.poses.panorama_step_deg, max(ranges))


def panorama_of_shard(wildcards):
    folder = f"results/{wildcards.site}/placement/round-{wildcards.round}"
    return f"{folder}/depth/{panorama_of(wildcards.site)}/{wildcards.shard}.parquet"


def pose_angles(angle):
    """Angles in which the rule's sensor is tried."""
    return lambda wildcards: setting(f"poses.{kind_of(wildcards.sensor)}.{angle}")(wildcards)


def criteria_of_sensor(wildcards):
    """When the rule's sensor sees a target: what its kind asks, and nothing else."""
    kind = kind_of(wildcards.sensor)
    if kind == "radar":
        return f"--rcs-m2 {setting('targets.rcs_m2')(wildcards)}"
    if kind == "camera":
        pixels = min_pixels_of(wildcards.site)
        return "" if pixels is None else f"--min-pixels {pixels}"
    return f"--min-beams {min_beams_of(wildcards.site)}"


# What a sensor's depth map has, or else a panorama: its name says all about it, no sensor's
# candidates limit it, it is never thinned, and levelled however the mount leans.
of_map = where(lambda wildcards: wildcards.sensor in SENSORS)
