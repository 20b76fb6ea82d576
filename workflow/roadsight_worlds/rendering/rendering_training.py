"""Images with their truth from other seeds of the rural family, for training small networks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from roadsight.base.sections.run import RuralScene
from roadsight.geometry.cameras import Intrinsics, cam_from_world
from roadsight_worlds.rendering.images import Camera, RenderedView, RuralRenderer
from roadsight_worlds.rendering.rendering_look import random_finish, random_look
from roadsight_worlds.rural.rural_road import RuralSite, build_rural


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


def random_training_view(seed: int, width_px: int = 640, height_px: int = 416) -> RenderedView:
    """One view of a short site of its own."""
    return next(random_training_views(seed, 1, width_px, height_px, 200.0))


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
