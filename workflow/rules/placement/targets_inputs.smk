"""Helpers of rules that look at targets: what they are, and what it takes to see them."""

from roadsight.placement.sight.probability import Curve
from roadsight.placement.sight.kinds import Box, room_for, shape_of


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
    shape = shape_of(SITES[wildcards.site].settings.targets.model_dump())
    return list(room_for(shape))


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


def least_beams(wildcards):
    return min_beams_of(wildcards.site)


def edges_of_targets(wildcards):
    """Edges along which targets stand, where they are boxes, or that bound the road."""
    site = SITES[wildcards.site].site
    needed = box_of(wildcards.site) is not None or site.placement.edges is not None
    return [f"results/{wildcards.site}/placement/edges.gpkg"] if needed else []


def target_width(wildcards):
    """Width of a target, whatever its kind: the lesser side of a box."""
    box = box_of(wildcards.site)
    targets = SITES[wildcards.site].settings.targets
    width_m = 2 * targets.radius_m if box is None else min(box.length_m, box.width_m)
    return width_m
