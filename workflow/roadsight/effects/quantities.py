"""What decides on each effect, measured on the scene, the settings and the sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from roadsight.placement.sensors.light import (
    CLEAR_M,
    contrast_range_m,
    fog_extinction_per_m,
    rain_extinction_per_m,
    range_in_air_m,
    reflectivity_range_m,
    rise_m,
    wavelength_nm,
)
from roadsight.placement.sensors.sensors import AnySensor, Camera, Radar, Rosette, Sensor
from roadsight.placement.sight.kinds import shape_of
from roadsight.placement.sight.passing import CAR, TRUCK, expected_in_the_way, vehicles_per_m
from roadsight.poles.drive.drive_lenses import with_given
from roadsight.poles.images.plumb_line import CERTAIN_SIGMAS

# The settings that quantities depend on: sections, whole or some of their keys.
SETTINGS: dict[str, set[str] | bool] = {
    "conditions": True,
    "lidar": {"model", "min_cell_points", "mounting", "azimuth_stride"},
    "candidates": {"spacing_m", "height_min_m", "height_max_m", "height_step_m"},
    "poses": {"panorama_step_deg"},
    "targets": {"kind", "radius_m", "height_m", "length_m", "width_m", "min_beams"},
    "calibration": {"hfov_deg"},
    "alignment": {"farthest_m"},
}


@dataclass(frozen=True)
class Circumstances:
    """A site as decisions see it.

    Parameters
    ----------
    profile : content of scene/profile.json. frame : content of scene/frame.json.
    settings : those named in `SETTINGS`, as plain values.
    sensors : that plans may place, by name.
    given : what the site gives the pole job beside the cloud: ``posed_share`` of its images,
        ``lenses``, ``baseline`` (registered cameras).
    drive : content of poles/drive.json, where the site asks for poles.
    """

    profile: Mapping[str, Any]
    frame: Mapping[str, Any]
    settings: Mapping[str, Mapping[str, Any]]
    sensors: Mapping[str, AnySensor]
    given: Mapping[str, Any]
    drive: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Quantity:
    """A measured quantity.

    Parameters
    ----------
    value : in the catalogue's unit; larger means that the effect matters more.
    remark : what it was measured on, or why it is zero.
    """

    value: float
    remark: str


def occurrences(per: str, circumstances: Circumstances) -> float:
    """How many times a site simulates an effect, roughly, before anything is placed.

    Candidates stand along both edges of the road, at every height.
    """
    candidates = circumstances.settings["candidates"]
    heights = (candidates["height_max_m"] - candidates["height_min_m"]) / candidates[
        "height_step_m"
    ] + 1
    length_m = float(max(circumstances.profile["extent_m"][:2]))  # longer side of the scene
    placed = 2 * (length_m / candidates["spacing_m"] + 1) * heights
    return float(
        {
            "site": 1.0,
            "candidate": placed,
            "map": placed * len(circumstances.sensors),
            "image": circumstances.drive.get("images", 0),
        }[per]
    )


# The placement job.

_NEAREST_LANES = 2.0  # between sensor and target of `moving_vehicles`: one direction of four lanes


def hole_filling(site: Circumstances) -> Quantity:
    """Share of the sensor's range whose road cells hold too few points, of the worst sensor.

    A cell of a by e radians at range r sees r a times r^2 e / h of the road from height h, so that
    cells nearer than the cube root of N h / (density a e) hold fewer than N points.
    """
    lidar = site.settings["lidar"]
    if lidar["model"] not in ("hybrid", "preliminary"):
        return Quantity(0.0, "surfels and networks fill no cells")
    wanted = lidar["min_cell_points"] * _middle_height_m(site)
    per_m2 = max(site.profile["density_per_m2"]["median"], 1e-9)

    def share(sensor: AnySensor) -> float:
        if isinstance(sensor, Sensor):
            lowest = np.radians(np.diff(sensor.elevation_edges_deg).min())
            cell = np.radians(sensor.azimuth_cell_deg * lidar["azimuth_stride"]) * lowest
        else:
            cell = np.radians(site.settings["poses"]["panorama_step_deg"]) ** 2
        return float(min(np.cbrt(wanted / (per_m2 * cell)) / sensor.range_m, 1.0))

    return _of_worst_sensor(site, share)


def overhead_cover(site: Circumstances) -> Quantity:
    """Area under something wider than a wire or a gantry."""
    area_m2 = site.profile["cover_core_m2"]
    return Quantity(area_m2, "cells whose neighbours are covered too")


def mount_tilt(site: Circumstances) -> Quantity:
    """Slope that the mounts follow."""
    if site.settings["lidar"]["mounting"] == "levelled":
        return Quantity(0.0, "mounts are levelled")
    return Quantity(site.profile["slope_deg"]["p95"], "95th percentile of smooth ground")


def partial_hits(site: Circumstances) -> Quantity:
    """Width of a beam where targets are just seen against a target's, of the widest beam."""
    width_m = shape_of(site.settings["targets"]).mean_width_m

    def share(sensor: AnySensor) -> float:
        if not isinstance(sensor, Sensor | Rosette) or sensor.divergence_mrad is None:
            return 0.0
        across = sensor.aperture_mm + sensor.divergence_mrad[0] * _useful_range_m(site, sensor)
        return across / 1000 / width_m

    return _of_worst_sensor(site, share)


def reflectivity(site: Circumstances) -> Quantity:
    """Share of the useful range that dark targets cost, of the sensor that loses most."""
    given = site.settings["conditions"]["target_reflectivity"]
    if given == 0:
        return Quantity(0.0, "no reflectivity of targets is given")

    def lost(sensor: AnySensor) -> float:
        if not isinstance(sensor, Sensor | Rosette):
            return 0.0
        return _lost(site, sensor, sensor.range_m, float(reflectivity_range_m(sensor, given)))

    return _of_worst_sensor(site, lost)


def rain(site: Circumstances) -> Quantity:
    """Share of the useful range that rain costs, of the sensor that loses most."""
    extinction = rain_extinction_per_m(site.settings["conditions"]["rain_mm_h"])
    return _of_worst_sensor(site, lambda sensor: _lost_to_air(site, sensor, extinction))


def fog(site: Circumstances) -> Quantity:
    """Share of the useful range that fog costs, of the sensor that loses most."""
    visibility_m = site.settings["conditions"]["visibility_m"]
    if visibility_m >= CLEAR_M:
        return Quantity(0.0, "the air is clear")

    def lost(sensor: AnySensor) -> float:
        if isinstance(sensor, Radar):
            return 0.0
        extinction = fog_extinction_per_m(visibility_m, wavelength_nm(sensor))
        return _lost_to_air(site, sensor, extinction)

    return _of_worst_sensor(site, lost)


def moving_vehicles(site: Circumstances) -> Quantity:
    """Chance that a vehicle hides a target two lanes off and as far along as is high.

    From half the sensor's range, at the middle height, on a straight level road; the middle of the
    target counts.
    """
    conditions = site.settings["conditions"]
    middle_m = shape_of(site.settings["targets"]).height_m / 2
    if conditions["aadt"] == 0:
        return Quantity(0.0, "no traffic volume is given")
    lane_m = conditions["lane_width_m"]
    per_m = vehicles_per_m(
        conditions["aadt"],
        conditions["truck_share"],
        conditions["speed_kmh"],
        conditions["peak_share"],
        2 * _NEAREST_LANES,
    )

    def chance(sensor: AnySensor) -> float:
        sensor_m = (0.0, 0.0, _middle_height_m(site))
        target_m = (sensor.range_m / 2, (_NEAREST_LANES + 0.5) * lane_m, middle_m)
        expected = sum(
            expected_in_the_way(sensor_m, target_m, (lane + 0.5) * lane_m, density, vehicle)
            for lane in range(int(_NEAREST_LANES))
            for density, vehicle in zip(per_m, (CAR, TRUCK), strict=True)
        )
        return float(-np.expm1(-expected))

    return _of_worst_sensor(site, chance)


def curvature_refraction(site: Circumstances) -> Quantity:
    """How far the beam of the farthest sensor rises above the level surface."""
    return _of_worst_sensor(site, lambda sensor: float(rise_m(sensor.range_m)))


def _useful_range_m(site: Circumstances, sensor: AnySensor) -> float:
    """Range up to which enough beams, points or pixels meet a target, if light did not limit it.

    A target of width w and height h at range d takes up w / d by h / d; the range is that at
    which so many of them share it. The densest rows of a spinning LiDAR count.
    """
    targets = site.settings["targets"]
    least = max(targets["min_beams"], 1)
    if isinstance(sensor, Sensor):
        rows = np.radians(np.diff(sensor.elevation_edges_deg).min())
        beam = np.radians(sensor.azimuth_cell_deg) * rows
    elif isinstance(sensor, Rosette):
        across, upright = np.radians(sensor.half_view_deg)
        beam = np.pi * across * upright / sensor.points
    elif isinstance(sensor, Camera):
        beam, least = 1 / sensor.focal_px**2, sensor.min_pixels
    else:
        return sensor.range_m
    shape = shape_of(targets)
    silhouette_m2 = shape.mean_width_m * shape.height_m
    return float(min(np.sqrt(silhouette_m2 / (beam * least)), sensor.range_m))


def _lost(site: Circumstances, sensor: AnySensor, before_m: float, after_m: float) -> float:
    """Share of the useful range that is lost where light carries less far than before."""
    useful_m = min(_useful_range_m(site, sensor), before_m)
    return 1 - min(useful_m, after_m) / useful_m


def _lost_to_air(site: Circumstances, sensor: AnySensor, extinction_per_m: float) -> float:
    """Share of the useful range that the air costs, on targets of the given reflectivity."""
    if isinstance(sensor, Camera):
        return _lost(site, sensor, sensor.range_m, contrast_range_m(extinction_per_m))
    if not isinstance(sensor, Sensor | Rosette):
        return 0.0
    given = site.settings["conditions"]["target_reflectivity"]
    clear_m = float(reflectivity_range_m(sensor, given)) if given else sensor.range_m
    return _lost(site, sensor, clear_m, float(range_in_air_m(clear_m, extinction_per_m)))


def _middle_height_m(site: Circumstances) -> float:
    candidates = site.settings["candidates"]
    return float(candidates["height_min_m"] + candidates["height_max_m"]) / 2


def _of_worst_sensor(site: Circumstances, value: Callable[[AnySensor], float]) -> Quantity:
    """The largest value of all sensors, and whose it is."""
    values = {name: value(sensor) for name, sensor in site.sensors.items()}
    if not values:
        return Quantity(0.0, "no sensor is to be placed")
    worst = max(values, key=lambda name: values[name])
    return Quantity(values[worst], f"for {worst}")


PLACEMENT: dict[str, Callable[[Circumstances], Quantity]] = {
    "hole_filling": hole_filling,
    "overhead_cover": overhead_cover,
    "mount_tilt": mount_tilt,
    "partial_hits": partial_hits,
    "reflectivity": reflectivity,
    "rain": rain,
    "fog": fog,
    "moving_vehicles": moving_vehicles,
    "curvature_refraction": curvature_refraction,
}


# The pole job.

_KNOWN_TO = 0.9  # fields of view are known to 10 %: a narrower one shows less of the roadside
_WIDTH_PX = 1000.0  # image width that pixels are told at


def terrain_occlusion(site: Circumstances) -> Quantity:
    """Share of the road within 240 m ahead of cameras that the ground hides."""
    share = site.drive["hidden_road_share"]
    if share is None:
        return Quantity(0.0, "no camera has road ahead")
    return Quantity(share, "sight lines over the height model")


def side_views(site: Circumstances) -> Quantity:
    """Share of the roadside that the front view cannot measure, where there are side images."""
    if site.drive["side_share"] == 0:
        return Quantity(0.0, "there are no side images")
    hfov_deg = _hfov_deg(site)
    if hfov_deg is None:
        return Quantity(1.0, "there are side images, and the field of view is not known")
    known = [(fov, gap) for fov, gap in site.drive["front_view_gaps"] if gap is not None]
    if not known:
        return Quantity(0.0, "the drive has no roadside")
    gap = float(np.interp(_KNOWN_TO * hfov_deg, *np.array(known, np.float64).T))
    return Quantity(gap, f"field of view of {hfov_deg:.0f} degrees")


def _hfov_deg(site: Circumstances) -> float | None:
    """Narrowest field of view that setting, cameras or baselines state; None if one is unknown."""
    if site.settings["calibration"]["hfov_deg"]:
        return float(site.settings["calibration"]["hfov_deg"])
    fields = []
    for lens in site.drive["lenses"]:
        width = lens["width_px"]
        baselines = site.given["baseline"]
        stated = baselines.get(f"{width}x{lens['height_px']}", baselines.get("all", {}))
        if "focal_px" in stated:
            fields.append(float(np.degrees(2 * np.arctan(0.5 * width / stated["focal_px"]))))
        elif "hfov_deg" in stated:
            fields.append(float(stated["hfov_deg"]))
        else:
            return None
    return min(fields, default=None)


def lens_distortion(site: Circumstances) -> Quantity:
    """Largest displacement at the corner of an image, at 1,000 pixels of image width."""
    worst = Quantity(0.0, "no image has enough upright outlines to tell")
    for lens in with_given(site.drive["lenses"], site.given["lenses"]):
        if lens["source"] == "unknown":
            continue
        to_px = _WIDTH_PX / lens["width_px"]
        moved_px = abs(lens["corner_px"]) * to_px
        sigma_px = None if lens["sigma_px"] is None else lens["sigma_px"] * to_px
        certain = sigma_px is not None and moved_px > CERTAIN_SIGMAS * sigma_px
        within = "" if sigma_px is None else f" +- {sigma_px:.1f}"
        told = f"{lens['source']}, {moved_px:.1f}{within} px on {lens['route']}"
        why = lens.get("withheld") or "may be none"
        found = Quantity(moved_px, told) if certain else Quantity(0.0, f"{told}: {why}")
        if found.value >= worst.value:
            worst = found
    return worst


def grid_convergence(site: Circumstances) -> Quantity:
    """Angle between grid north and true north in the middle of the scene."""
    location = site.frame["location"]
    if location is None:
        return Quantity(0.0, "a local system has no true north")
    return Quantity(abs(location["convergence_deg"]), "in the middle of the scene")


def scale_factor(site: Circumstances) -> Quantity:
    """Difference between grid and ground distances in the middle of the scene."""
    location = site.frame["location"]
    if location is None:
        return Quantity(0.0, "a local system has no grid")
    scales = (location["scale_east"], location["scale_north"])
    return Quantity(max(abs(scale - 1) for scale in scales) * 1e6, "in the middle of the scene")


def road_alignment(site: Circumstances) -> Quantity:
    """Share of images whose camera pose is not given."""
    share = float(site.given["posed_share"])
    return Quantity(1.0 - share, "poses are given" if share else "no pose is given")


def sight_curvature(site: Circumstances) -> Quantity:
    """How much lower than on a plane the farthest road edge looks that cameras are aligned to."""
    farthest_m = site.settings["alignment"]["farthest_m"]
    return Quantity(float(rise_m(farthest_m)), f"at {farthest_m:.0f} m")


POLES: dict[str, Callable[[Circumstances], Quantity]] = {
    "terrain_occlusion": terrain_occlusion,
    "side_views": side_views,
    "lens_distortion": lens_distortion,
    "grid_convergence": grid_convergence,
    "scale_factor": scale_factor,
    "road_alignment": road_alignment,
    "sight_curvature": sight_curvature,
}
