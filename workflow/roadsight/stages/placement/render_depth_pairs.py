"""Preliminary and refined depth maps at random places of a site, to train a network on.

The paper's pairs (section 2.4, Fig. 11): a sensor of Table 1 with a random range at a random height
of 4 to 20 m; the refined map is Algorithm 1's.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.base.errors import InputError
from roadsight.base.sections.run import Run
from roadsight.io.cloud.tiles import StandingCloud
from roadsight.io.records.depth_maps import stack_pairs, write_pairs
from roadsight.io.records.tables import read_table
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.unet import HEIGHTS_M, RANGES_M, training_sensor
from roadsight.stages.command import Command, logged

log = logging.getLogger("render_depth_pairs")

_COLUMNS = ["x", "y", "ground_z_m", "yaw_deg"]
"""What is used of a candidate: its place and where it faces, not its height."""


def render_depth_pairs(
    candidates: Path,
    cloud_path: Path,
    seed: Annotated[int, Run],
    traffic: Annotated[Path | None, "mask of points to leave out"] = None,
    pairs: int = 24,
    span_deg: Annotated[float, "azimuths of a map"] = 90.0,
    *,
    out: Annotated[Path, "NPZ file"],
) -> None:
    """Write the pairs of one site."""
    rng = np.random.default_rng(seed)
    table = read_table(candidates, _COLUMNS)
    if table.empty:
        raise InputError("has no candidate to stand at", where=str(candidates))
    chosen = table.iloc[rng.integers(len(table), size=pairs)]
    poses = chosen[_COLUMNS].to_numpy(np.float64, copy=True)
    poses[:, 2] += rng.uniform(*HEIGHTS_M, len(poses))
    cloud = StandingCloud(cloud_path, traffic)
    reach_m = max(RANGES_M)
    west, south = poses[:, :2].min(axis=0) - reach_m
    east, north = poses[:, :2].max(axis=0) + reach_m
    xyz_m = cloud.xyz_within((west, south, east, north))
    made = []
    for *position_m, yaw_deg in logged(poses, len(poses), log, "pairs"):
        sensor = training_sensor(rng, span_deg)
        seen = xyz_m, sensor, position_m, float(yaw_deg)
        made.append((preliminary_depth(*seen), hybrid_depth(*seen)))
    write_pairs(out, stack_pairs(made))


main = Command(render_depth_pairs)


if __name__ == "__main__":
    sys.exit(main())
