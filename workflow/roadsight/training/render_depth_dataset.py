"""Render pairs of depth maps in generated scenes, each of a seed of its own.

Of every scene two files are written, which share their preliminary maps: in ``*.hybrid.npz`` the
refined map is the paper's (Algorithm 1 at 0.1 degrees), in ``*.exact.npz`` it is the truth.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

import numpy as np

from roadsight.base.errors import InputError
from roadsight.io.records.depth_pairs import stack_pairs, write_pairs
from roadsight.placement.depth.depth_sensor import training_sensor
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.stages.command import run_stage
from roadsight.training.depth_scenes import ScannedScene, highway_site, simple_site

log = logging.getLogger("render_depth_dataset")

_KINDS = {"highway": highway_site, "simple": simple_site}
TRUTHS = ("hybrid", "exact")


def render_depth_dataset(arguments: argparse.Namespace) -> None:
    """Write the pairs of ``highways`` highways and ``simple`` analytic scenes."""
    if min(arguments.highways, arguments.simple) < 0 or arguments.poses < 1:
        raise InputError("--highways and --simple must be 0 or more, --poses 1 or more")
    for kind, count in (("highway", arguments.highways), ("simple", arguments.simple)):
        for seed in range(arguments.first_seed, arguments.first_seed + count):
            site = _KINDS[kind](seed, arguments.poses)
            _write(site, seed, Path(arguments.out) / f"{kind}_{seed}", arguments.span_deg)
            log.info("%s %d: %d points", kind, seed, len(site.cloud_m))


def _write(site: ScannedScene, seed: int, stem: Path, span_deg: float) -> None:
    rng = np.random.default_rng([seed, 3])
    pairs: dict[str, list] = {truth: [] for truth in TRUTHS}
    for number, (position, yaw_deg) in enumerate(zip(site.positions_m, site.yaws_deg, strict=True)):
        sensor = training_sensor(rng, span_deg)
        seen = site.cloud_m, sensor, position, float(yaw_deg)
        preliminary = preliminary_depth(*seen)
        pairs["hybrid"].append((preliminary, hybrid_depth(*seen)))
        pairs["exact"].append((preliminary, site.exact(sensor, number)))
    for truth, maps in pairs.items():
        write_pairs(f"{stem}.{truth}.npz", stack_pairs(maps))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", required=True, help="folder of the NPZ files")
    parser.add_argument("--first-seed", type=int, default=2000)
    parser.add_argument("--highways", type=int, default=16, help="generated highways")
    parser.add_argument("--simple", type=int, default=8, help="analytic scenes")
    parser.add_argument("--poses", type=int, default=12, help="sensors in a scene")
    parser.add_argument("--span-deg", type=float, default=90.0, help="azimuths of a sensor")
    return run_stage(parser, render_depth_dataset, argv)


if __name__ == "__main__":
    sys.exit(main())
