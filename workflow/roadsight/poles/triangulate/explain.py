"""Poles that explain the rays, with what the rays tell about their own errors.

Rays are grouped by how well they agree, so that groups look better than the rays are: errors that
are found from groups that were made with found errors shrink turn by turn. They are found from
groups made with the stated errors, once again, and later only widened.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.triangulate.association import Grower, Pole, Work, find_neighbours
from roadsight.poles.triangulate.exchange import associate
from roadsight.poles.triangulate.likelihood import likelihood
from roadsight.poles.triangulate.noise import Noise, fit_noise, place_groups, stated_noise
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

_ROUNDS = 7
"""Turns of association and of finding errors and depth scale; most drives rest after four."""
_AS_STATED = 2
"""Turns with the stated errors, in which the depth scale comes to rest: errors that are found at a
wrong scale are too wide."""
_NARROWING = 2
"""Fits of the errors that may narrow them. With one, errors that are stated 4 times too wide stay
too wide; with no end, they shrink to half of what they are on 173 ambiguous sightings."""
_FEWEST_DEPTHS = 30
"""Depths that the factor needs, as the median of their ratios."""
_SCALES = (0.5, 2.0)
"""Bounds of the factor: beyond, groups rather than depths are wrong."""
_WELL_CROSSED = 0.1
"""Least eigenvalue of the rays' normal matrix, a sum of squared sines: below, rays are so parallel
that bearings alone do not tell the distance."""


@dataclass(frozen=True)
class Explained:
    """What explains the rays.

    Parameters
    ----------
    groups : rays of each pole, from west to east and south to north. place_m : (g, 2).
    covariance : of the places, m2, (g, 2, 2). gain : log evidence of each, (g,).
    scale : what depths were multiplied by; 1 if not calibrated.
    """

    groups: list[Ints]
    place_m: Floats
    covariance: Floats
    gain: Floats
    scale: float
    noise: Noise


def explain_rays(
    rays: Rays, settings: TriangulationSettings, work: Work | None = None
) -> Explained:
    """Poles of rays, found in turns: poles, then the errors and the scale that they show.

    Parameters
    ----------
    work : counts operations, for tests.
    """
    near = find_neighbours(rays, settings)
    noise, scale, scaled = stated_noise(settings), 1.0, rays
    poles: list[Pole] = []
    work = work or Work()
    fits = 0
    for turn in range(_ROUNDS if len(rays) else 0):
        before = [pole.key for pole in poles]
        model = likelihood(scaled, near, poles, noise, settings)
        poles = associate(Grower(scaled, near, model, work))
        rests = [pole.key for pole in poles] == before
        if rests and fits >= _NARROWING:
            break
        groups = [pole.members for pole in poles]
        if settings.calibrate_depth:
            scale = depth_scale(rays, groups, scale)
            scaled = rays.scaled(scale)
        if turn >= _AS_STATED or rests:
            latest = fit_noise(scaled, groups, _places(poles), settings)
            noise = latest if fits < _NARROWING else noise.or_wider(latest)
            fits += 1
    groups = [pole.members for pole in poles]
    places, covariances = place_groups(scaled, groups, _places(poles), noise, settings)
    order = np.lexsort(places.T[::-1])
    return Explained(
        [groups[number] for number in order],
        places[order],
        covariances[order],
        np.array([poles[number].gain for number in order]),
        scale,
        noise,
    )


def _places(poles: list[Pole]) -> Floats:
    return np.array([(pole.x, pole.y) for pole in poles]).reshape(-1, 2)


def depth_scale(rays: Rays, groups: list[Ints], otherwise: float) -> float:
    """Factor that brings the monocular depths to the distances of the crossings.

    Depth networks err by a common factor. Poles with three and more well-crossed views are located
    by bearings alone; the factor is the median of distance over depth. Without enough such views it
    is ``otherwise``.
    """
    ratios = [depth_ratios(rays, members) for members in groups]
    found = np.concatenate([*ratios, np.empty(0)])
    if len(found) < _FEWEST_DEPTHS:
        return otherwise
    return float(np.clip(np.median(found), *_SCALES))


def depth_ratios(rays: Rays, members: Ints) -> Floats:
    """Distance by bearings alone over depth, of each ray of a well-crossed group."""
    if len(members) < 3:
        return np.empty(0)
    ahead = rays.direction[members]
    side = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    normal = side.T @ side
    if np.linalg.eigvalsh(normal)[0] < _WELL_CROSSED:
        return np.empty(0)
    camera = rays.camera_m[members] - rays.camera_m[members[0]]
    place = np.linalg.solve(normal, side.T @ (side * camera).sum(axis=1))
    distance = ((place - camera) * ahead).sum(axis=1)
    ratio = distance / rays.depth_m[members]
    return ratio[np.isfinite(ratio) & (ratio > 0) & ~rays.anchored[members]]
