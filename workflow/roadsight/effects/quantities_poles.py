"""What decides on each effect of the pole job, measured on the scene and what the site gives."""

from __future__ import annotations

from collections.abc import Callable

from roadsight.effects.circumstances import Circumstances, Quantity


def terrain_occlusion(site: Circumstances) -> Quantity:
    """Slope of the ground: level ground hides no road."""
    return Quantity(site.profile["slope_deg"]["p95"], "95th percentile of smooth ground")


def side_views(site: Circumstances) -> Quantity:
    """Side images for each front image."""
    return Quantity(float(site.given["side_views"]), "named by the videolog")


def lens_distortion(site: Circumstances) -> Quantity:
    """Displacement of pixels at the image's corner by the lens, where the site gives a lens."""
    return Quantity(float(site.given["distortion_px"]), "of the cameras that the site gives")


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
    known = bool(site.given["camera_poses"])
    return Quantity(0.0 if known else 1.0, "poses are given" if known else "no pose is given")


QUANTITIES: dict[str, Callable[[Circumstances], Quantity]] = {
    "terrain_occlusion": terrain_occlusion,
    "side_views": side_views,
    "lens_distortion": lens_distortion,
    "grid_convergence": grid_convergence,
    "scale_factor": scale_factor,
    "road_alignment": road_alignment,
}
"""How the quantity of each effect is measured."""
