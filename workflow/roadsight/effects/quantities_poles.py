"""What decides on each effect of the pole job, measured on the scene and what the site gives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from roadsight.effects.circumstances import Circumstances, Quantity
from roadsight.placement.sensors.earth import rise_m
from roadsight.poles.drive.drive_lenses import with_given
from roadsight.poles.images.plumb_line import CERTAIN_SIGMAS

_KNOWN_TO = 0.9
"""Fields of view are known to 10 %: a narrower one shows less of the roadside."""
_WIDTH_PX = 1000.0
"""Image width that pixels are told at."""


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
"""How the quantity of each effect is measured."""
