"""The published alignment, kept as a reference (paper 2, section 3.2.4).

Nelder-Mead on the mean squared distance from each projected LiDAR edge point to the nearest edge
pixel of its own side within a window, box bounds around the baseline, 1,000 iterations.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import Bounds, minimize

from roadsight.base.arrays import Floats
from roadsight.base.kernels import compiled
from roadsight.base.sections.poles import AlignmentLimits
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.poles.alignment.pose import FOCAL, SIZE, Start, pose_of
from roadsight.poles.alignment.roadside import NearEdges
from roadsight.poles.alignment.solve import ImageEdges

PUBLISHED_BOUNDS = (AlignmentLimits().bound_m, AlignmentLimits().bound_deg)
"""How far its result may be from the baseline, m and degrees: 1.1 ft and 0.11 in the paper."""
_UNITS = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01])
"""What one unit of a step is: metres, degrees, and 1 % of the focal length."""


def nelder_mead(
    start: Start,
    image_edges: ImageEdges,
    map_edges: NearEdges,
    mean: Floats,
    *,
    window_px: float = 300.0,
    bound_m: float = PUBLISHED_BOUNDS[0],
    bound_deg: float = PUBLISHED_BOUNDS[1],
    iterations: int = 1000,
) -> tuple[Floats, float]:
    """Unknowns (SIZE,) of one image, and the root of the mean squared distance in pixels.

    Parameters
    ----------
    mean : (SIZE,) baseline, where the search starts; insets are not used.
    window_px : edge pixels further off than this, along either axis, do not count.
    bound_m, bound_deg : how far the result may be from the baseline (1.1 ft, 0.11 degrees in the
        paper); the focal length may change by 1 %.
    """
    bounds = np.array([bound_m] * 3 + [bound_deg] * 3 + [1.0])
    pixels = [
        np.concatenate([_part(image_edges, side), _part(image_edges, side + 2)]) for side in (0, 1)
    ]

    def cost(step: Floats) -> float:
        return _mean_square(start, map_edges, pixels, _moved(mean, step), window_px)

    result = minimize(
        cost,
        np.zeros(FOCAL + 1),
        method="Nelder-Mead",
        bounds=Bounds(-bounds, bounds),
        options={
            "maxiter": iterations,
            "maxfev": 4 * iterations,
            "initial_simplex": np.vstack([np.zeros(FOCAL + 1), np.diag(0.5 * bounds)]),
        },
    )
    return _moved(mean, result.x), float(np.sqrt(result.fun))


def _part(image_edges: ImageEdges, group: int) -> Floats:
    return image_edges.uv_px[image_edges.groups[group] : image_edges.groups[group + 1]]


def _moved(mean: Floats, step: Floats) -> Floats:
    unknowns = mean.copy()
    unknowns[: FOCAL + 1] += step * _UNITS
    return unknowns[:SIZE]


def _mean_square(
    start: Start, map_edges: NearEdges, pixels: list[Floats], unknowns: Floats, window_px: float
) -> float:
    pose = pose_of(start, unknowns)
    camera = Intrinsics(start.width_px, start.height_px, pose.focal_px, pose.cx_px, start.cy_px)
    rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
    uv, _ = project(camera, rotation, pose.position_m, map_edges.xyz_m)
    inside = camera.contains(uv)
    total, count = 0.0, 0
    for side, part in enumerate((slice(None, map_edges.left), slice(map_edges.left, None))):
        gained, found = squared_gaps(uv[part][inside[part]], pixels[side], window_px)
        total, count = total + gained, count + found
    return total / count if count else window_px**2


@compiled(error_model="numpy")
def squared_gaps(points: Floats, pixels: Floats, window_px: float) -> tuple[float, int]:
    """Sum of squared distances to the nearest pixel in the window, and of how many points."""
    total, count = 0.0, 0
    for i in range(len(points)):
        best = np.inf
        for j in range(len(pixels)):
            du, dv = abs(pixels[j, 0] - points[i, 0]), abs(pixels[j, 1] - points[i, 1])
            if du <= window_px and dv <= window_px:
                best = min(best, du * du + dv * dv)
        if best < np.inf:
            total += best
            count += 1
    return total, count
