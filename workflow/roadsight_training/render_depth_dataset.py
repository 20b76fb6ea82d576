"""Render pairs of depth maps in generated scenes, each of a seed of its own.

Of every scene two files are written, which share their preliminary maps: in ``*.hybrid.npz`` the
refined map is the paper's (Algorithm 1 at 0.1 degrees), in ``*.exact.npz`` it is the truth.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.base.errors import InputError
from roadsight.io.records.depth_maps import stack_pairs, write_pairs
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.unet import training_sensor
from roadsight.stages.command import Command
from roadsight_training.depth_scenes import highway_site, simple_site

log = logging.getLogger("render_depth_dataset")

_KINDS = {"highway": highway_site, "simple": simple_site}
TRUTHS = ("hybrid", "exact")


def render_depth_dataset(
    out: Annotated[Path, "folder of the NPZ files"],
    first_seed: int = 2000,
    highways: Annotated[int, "generated highways"] = 16,
    simple: Annotated[int, "analytic scenes"] = 8,
    poses: Annotated[int, "sensors in a scene"] = 12,
    span_deg: Annotated[float, "azimuths of a sensor"] = 90.0,
) -> None:
    """Write the pairs of ``highways`` highways and ``simple`` analytic scenes."""
    if min(highways, simple) < 0 or poses < 1:
        raise InputError("--highways and --simple must be 0 or more, --poses 1 or more")
    for kind, count in (("highway", highways), ("simple", simple)):
        for seed in range(first_seed, first_seed + count):
            site = _KINDS[kind](seed, poses)
            rng = np.random.default_rng([seed, 3])
            pairs: dict[str, list] = {truth: [] for truth in TRUTHS}
            for k, (position, yaw_deg) in enumerate(
                zip(site.positions_m, site.yaws_deg, strict=True)
            ):
                sensor = training_sensor(rng, span_deg)
                seen = site.cloud_m, sensor, position, float(yaw_deg)
                preliminary = preliminary_depth(*seen)
                pairs["hybrid"].append((preliminary, hybrid_depth(*seen)))
                pairs["exact"].append((preliminary, site.exact(sensor, k)))
            for truth, maps in pairs.items():
                write_pairs(out / f"{kind}_{seed}.{truth}.npz", stack_pairs(maps))
            log.info("%s %d: %d points", kind, seed, len(site.cloud_m))


main = Command(render_depth_dataset)


if __name__ == "__main__":
    sys.exit(main())
