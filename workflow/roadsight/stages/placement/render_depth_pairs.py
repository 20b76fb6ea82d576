"""Preliminary and refined depth maps at random places of a site, to train a network on.

The paper's pairs (section 2.4, Fig. 11): a sensor of Table 1 with a random range at a random height
of 4 to 20 m; the refined map is Algorithm 1's.
"""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.io.cloud.standing import StandingCloud
from roadsight.io.records.depth_pairs import stack_pairs, write_pairs
from roadsight.io.records.tables import read_table
from roadsight.placement.depth.depth_sensor import HEIGHTS_M, RANGES_M, training_sensor
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("render_depth_pairs")

_COLUMNS = ["x", "y", "ground_z_m", "yaw_deg"]
"""What is used of a candidate: its place and where it faces, not its height."""


def render_depth_pairs(arguments: argparse.Namespace) -> None:
    """Write the pairs of one site."""
    rng = np.random.default_rng(arguments.seed)
    poses = _poses(arguments, rng)
    cloud = StandingCloud(arguments.cloud, arguments.traffic)
    reach_m = max(RANGES_M)
    west, south = poses[:, :2].min(axis=0) - reach_m
    east, north = poses[:, :2].max(axis=0) + reach_m
    xyz_m = cloud.xyz_within((west, south, east, north))
    pairs = []
    for *position_m, yaw_deg in logged(poses, len(poses), log, "pairs"):
        sensor = training_sensor(rng, arguments.span_deg)
        seen = xyz_m, sensor, position_m, float(yaw_deg)
        pairs.append((preliminary_depth(*seen), hybrid_depth(*seen)))
    write_pairs(arguments.out, stack_pairs(pairs))


def _poses(arguments: argparse.Namespace, rng: np.random.Generator) -> Floats:
    """Random candidates (n, 4) at random heights: x, y, z and yaw."""
    candidates = read_table(arguments.candidates, _COLUMNS)
    if candidates.empty:
        raise InputError("has no candidate to stand at", where=arguments.candidates)
    chosen = candidates.iloc[rng.integers(len(candidates), size=arguments.pairs)]
    poses = chosen[_COLUMNS].to_numpy(np.float64, copy=True)
    poses[:, 2] += rng.uniform(*HEIGHTS_M, len(poses))
    return poses


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidates", required=True)
    parser.add_argument("--cloud", required=True)
    parser.add_argument("--traffic", nargs="?", help="mask of points to leave out")
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--span-deg", type=float, default=90.0, help="azimuths of a map")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", required=True, help="NPZ file")
    return run_stage(parser, render_depth_pairs, argv)


if __name__ == "__main__":
    sys.exit(main())
