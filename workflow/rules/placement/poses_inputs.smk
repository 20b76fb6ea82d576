"""Helpers of sensors in poses: which these are, their angles, and the panoramas that judge them."""

from roadsight.placement.sensors.sensors import AimedSensor
from roadsight.placement.sensors.poses import AS_MOUNTED, turns_of
from roadsight.placement.sensors.sensors import panorama_name


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

    def angles(wildcards):
        path = f"poses.{kind_of(wildcards.sensor)}.{angle}"
        return setting(path)(wildcards)

    return angles


def criteria_of_sensor(wildcards):
    """When the rule's sensor sees a target: what its kind asks, and nothing else."""
    kind = kind_of(wildcards.sensor)
    if kind == "radar":
        asked = f"--rcs-m2 {setting('targets.rcs_m2')(wildcards)}"
    elif kind == "camera":
        pixels = min_pixels_of(wildcards.site)
        asked = "" if pixels is None else f"--min-pixels {pixels}"
    else:
        asked = f"--min-beams {min_beams_of(wildcards.site)}"
    return asked


def sensor_of_map(wildcards):
    """Definition of the sensor of a depth map; a panorama's name says all about it."""
    return sensor_definition(wildcards) if wildcards.sensor in SENSORS else wildcards.sensor


def stride_of_map(wildcards):
    """Panoramas are never thinned."""
    stride = setting("lidar.azimuth_stride")(wildcards)
    return stride if wildcards.sensor in SENSORS else 1


def tilts_of_map(wildcards):
    """Panoramas are levelled, however the mount leans."""
    return TILTS_OF_ROUND if wildcards.sensor in SENSORS else []


def panorama_flag(wildcards):
    """Said of a map that no sensor's own candidates limit."""
    return "" if wildcards.sensor in SENSORS else "--panorama"
