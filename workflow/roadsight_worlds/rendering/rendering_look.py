"""Weather, season and camera finish, drawn at random; and views of other seeds to train on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from roadsight.base.sections.run import RuralScene
from roadsight.geometry.cameras import Intrinsics, cam_from_world
from roadsight_worlds.rendering.images import Camera, Finish, RenderedView, RuralRenderer
from roadsight_worlds.rendering.rendering_shade import Look
from roadsight_worlds.rural.rural_road import RuralSite, build_rural

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


def random_training_views(
    seed: int,
    count: int,
    width_px: int = 640,
    height_px: int = 416,
    length_m: float = 500.0,
    panels_per_km: float = 0.0,
    cars_per_km: float = 0.0,
    lanes: int = RuralScene().lanes,
) -> Iterator[RenderedView]:
    """Views of one site of its own: random places, cameras, weather, exposure.

    Building the site costs about four CPU seconds, a view a third of one; so ask for many views a
    seed, and for many seeds. Seeds of sites in use (the sample's is 1) must not be trained on.

    Parameters
    ----------
    seed : of the site and of everything else; the same arguments give the same views.
    panels_per_km : signs of any form and colour beside the usual ones.
    cars_per_km : cars parked beside the road beside the usual ones. lanes : of each direction.
    """
    site = build_rural(
        seed,
        length_m,
        panels_per_km=panels_per_km,
        cars_per_km=cars_per_km,
        scene=RuralScene(lanes=lanes),
    )
    renderer = RuralRenderer(site)
    rng = np.random.default_rng([seed, 11])
    for _ in range(count):
        camera = _random_camera(site, width_px, height_px, rng)
        finish = replace(random_finish(rng), exposure=float(np.exp(rng.normal(0.0, 0.18))))
        yield renderer.render_view(camera, random_look(rng), finish, int(rng.integers(2**31)))


def _random_camera(
    site: RuralSite, width_px: int, height_px: int, rng: np.random.Generator
) -> Camera:
    """Camera in either lane that looks ahead (two of three) or aside, narrow or wide."""
    station, way = rng.uniform(0.0, site.length_m), rng.choice([-1.0, 1.0])
    lateral = -way * 1.6 + rng.normal(0.0, 0.3)
    aside = rng.choice([0.0, 0.0, -20.5, 20.5, rng.uniform(-75.0, 75.0), 0.0])
    fov = rng.choice([rng.uniform(18.0, 25.0), rng.uniform(25.0, 70.0)])
    along = 90.0 - float(np.degrees(site.line.heading(station))) + (180.0 if way < 0 else 0.0)
    grade = way * float(np.degrees(np.arctan(site.line.grade(station))))
    rotation = cam_from_world(
        along + aside + rng.normal(0.0, 1.2), grade + rng.normal(-1.0, 1.2), rng.normal(-0.7, 1.0)
    )
    eye = float(site.ground.height(station, lateral)) + rng.uniform(1.4, 2.6)
    position = np.array([*site.line.plan(station, lateral), eye])
    return Camera(Intrinsics.from_field_of_view(width_px, height_px, fov), rotation, position)
