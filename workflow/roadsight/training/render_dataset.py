"""Render training views of many sites, each of a seed of its own."""

from __future__ import annotations

import argparse
import logging
import sys

from roadsight.base.errors import InputError
from roadsight.stages.command import run_stage
from roadsight.synthetic.rendering.rendering_training import random_training_views
from roadsight.training.samples import Sample, write_sample

log = logging.getLogger("render_dataset")

_SIZES_PX = ((640, 416), (768, 512))
"""Width and height of the views of even and of odd seeds: those of the sample's two cameras."""
_SITE_LENGTH_M = 500.0
"""Of each generated site."""


def render_dataset(arguments: argparse.Namespace) -> None:
    """Write ``views`` views of each of ``sites`` sites."""
    if arguments.sites < 1 or arguments.views < 1:
        raise InputError(
            "--sites and --views must be 1 or more",
            found=f"{arguments.sites} and {arguments.views}",
        )
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.sites):
        width_px, height_px = _SIZES_PX[seed % 2]
        views = random_training_views(seed, arguments.views, width_px, height_px, _SITE_LENGTH_M)
        for number, view in enumerate(views):
            sample = Sample(view.colour, view.classes, view.inverse_depth())
            write_sample(arguments.out, seed, number, sample)
        log.info("seed %d: %d views of %d x %d", seed, arguments.views, width_px, height_px)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", required=True, help="folder of the PNG files")
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--sites", type=int, default=44)
    parser.add_argument("--views", type=int, default=12, help="views of a site")
    return run_stage(parser, render_dataset, argv)


if __name__ == "__main__":
    sys.exit(main())
