"""What decisions on effects rest on: the measured scene, the settings, the sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from roadsight.placement.sensors.sensors import AnySensor

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


def road_length_m(circumstances: Circumstances) -> float:
    """Rough length of the road: the longer side of the scene."""
    return float(max(circumstances.profile["extent_m"][:2]))


def occurrences(per: str, circumstances: Circumstances) -> float:
    """How many times a site simulates an effect, roughly, before anything is placed.

    Candidates stand along both edges of the road, at every height.
    """
    candidates = circumstances.settings["candidates"]
    heights = (candidates["height_max_m"] - candidates["height_min_m"]) / candidates[
        "height_step_m"
    ] + 1
    placed = 2 * (road_length_m(circumstances) / candidates["spacing_m"] + 1) * heights
    return float(
        {
            "site": 1.0,
            "candidate": placed,
            "map": placed * len(circumstances.sensors),
            "image": circumstances.drive.get("images", 0),
        }[per]
    )
