"""Render training views of many sites, each of a seed of its own."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

from roadsight.base.errors import InputError
from roadsight.base.sections.run import RuralScene
from roadsight.stages.command import Command
from roadsight_training.samples import Sample, write_sample
from roadsight_worlds.rendering.rendering_look import random_training_views

log = logging.getLogger("render_dataset")
# Width and height of the views of even and of odd seeds: those of the sample's two cameras.
_SIZES_PX = ((640, 416), (768, 512))
_SITE_LENGTH_M = 500.0  # Of each generated site.


def render_dataset(
    out: Annotated[Path, "folder of the PNG files"],
    first_seed: int = 1000,
    sites: int = 44,
    views: Annotated[int, "views of a site"] = 12,
    panels_per_km: Annotated[float, "signs of any form and colour beside the usual ones"] = 0.0,
    cars_per_km: Annotated[float, "cars parked beside the road beside the usual ones"] = 0.0,
    lanes: Annotated[int, "of each direction"] = RuralScene().lanes,
) -> None:
    """Write ``views`` views of each of ``sites`` sites."""
    if sites < 1 or views < 1:
        raise InputError("--sites and --views must be 1 or more", found=f"{sites} and {views}")
    for seed in range(first_seed, first_seed + sites):
        width_px, height_px = _SIZES_PX[seed % 2]
        shown = random_training_views(
            seed, views, width_px, height_px, _SITE_LENGTH_M, panels_per_km, cars_per_km, lanes
        )
        for number, view in enumerate(shown):
            sample = Sample(view.colour, view.classes, view.inverse_depth())
            write_sample(out, seed, number, sample)
        log.info("seed %d: %d views of %d x %d", seed, views, width_px, height_px)


main = Command(render_dataset)


if __name__ == "__main__":
    sys.exit(main())
