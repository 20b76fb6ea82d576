"""Weather, season and camera finish, drawn at random."""

from __future__ import annotations

import numpy as np

from roadsight_worlds.rendering.images import Finish
from roadsight_worlds.rendering.rendering_shade import Look

_SUN_BGR = np.array([0.82, 0.95, 1.06])  # Colour of sunlight: a little yellow.
_SKY_BGR = np.array([1.15, 1.0, 0.88])  # Colour of the light of the sky: a little blue.


def random_look(rng: np.random.Generator) -> Look:
    """Fair, hazy or overcast day."""
    overcast = rng.uniform() < 0.25
    cloud = rng.uniform(0.55, 0.75) if overcast else rng.uniform(0.15, 0.5)
    turn, up = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(28.0, 62.0))
    sun = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    strength = rng.uniform(0.12, 0.3) if overcast else rng.uniform(0.95, 1.25)
    ambient = rng.uniform(0.75, 0.95) if overcast else rng.uniform(0.34, 0.5)
    grey = np.array([0.86, 0.84, 0.82])
    blue = np.array([0.78, 0.5, 0.3]) * rng.uniform(0.8, 1.1)
    return Look(
        sun=sun,
        sun_light=strength * _SUN_BGR,
        sky_light=ambient * _SKY_BGR,
        haze_m=float(rng.uniform(600.0, 2200.0)),
        horizon=np.array([0.93, 0.86, 0.8]) if not overcast else 0.95 * grey,
        zenith=0.82 * grey if overcast else blue,
        cloud=float(cloud),
        seed=int(rng.integers(1, 1_000_000)),
        lush=float(rng.uniform(0.3, 0.9)),
        asphalt=float(rng.uniform(0.15, 0.27)),
        wear=float(rng.uniform(0.1, 0.6)),
    )


def random_finish(rng: np.random.Generator) -> Finish:
    """Exposure and white balance that differ a little from image to image."""
    return Finish(
        exposure=float(np.exp(rng.normal(0.0, 0.07))),
        balance=tuple(np.exp(rng.normal(0.0, 0.015, 3)).tolist()),
        blur_px=float(rng.uniform(0.45, 0.65)),
        noise=float(rng.uniform(1.2, 2.6)),
    )


def drive_look(seed: int, number: int) -> Look:
    """Weather of one drive of a site; textures are those of the site."""
    rng = np.random.default_rng([seed, 41, number])
    site = random_look(np.random.default_rng([seed, 42]))
    fixed = {name: getattr(site, name) for name in ("seed", "lush", "asphalt", "wear")}
    return random_look(rng)._replace(**fixed)
