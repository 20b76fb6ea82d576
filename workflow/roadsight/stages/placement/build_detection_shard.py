"""Which targets a sensor sees from the candidates of one shard."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.detections import write_detections
from roadsight.io.records.lanes import read_traffic
from roadsight.io.records.poses import read_poses, read_tilts
from roadsight.placement.sensors.sensors import Sensor, load_sensor
from roadsight.placement.sight.lanes import free_shares
from roadsight.placement.sight.shapes import Box, Shape
from roadsight.placement.sight.sight import count_beams
from roadsight.stages.command import run_stage
from roadsight.stages.placement.detection_inputs import (
    add_detection_arguments,
    read_shaped_targets,
    said_of_shape,
    sight_of,
)
from roadsight.stages.progress import logged

log = logging.getLogger("build_detection_shard")

_MOST_HITS = np.iinfo(np.uint16).max
"""Hits are written in 16 bits; what is nearer than that many need not be told apart."""


def build_detection_shard(arguments: argparse.Namespace) -> None:
    """Write a row for each target seen, by candidate and then by target."""
    targets, feet_m, shape = read_shaped_targets(arguments)
    traffic = read_traffic(arguments.lanes[0]) if arguments.lanes else None
    names, hits, free = [], [], []
    for name, position_m, beams in _hits(arguments, feet_m, shape):
        seen = np.flatnonzero(beams > arguments.min_beams)
        if traffic is not None:
            middles = feet_m[seen, :3] + np.array([0.0, 0.0, shape.height_m / 2])
            shares = free_shares(traffic.lanes, position_m, middles)
            often = shares >= traffic.availability
            seen = seen[often]
            free.append(shares[often])
        names.append(name)
        counts = np.ceil(beams[seen]).astype(np.int32)
        hits.append(pd.Series(np.minimum(counts, _MOST_HITS), index=seen))
    detections = _table(names, hits, targets["target"])
    if traffic is not None:
        detections["availability"] = np.concatenate([[], *free]).astype(np.float32)
    log.info("%d candidates, %d targets, %d seen", len(names), len(targets), len(detections))
    about = said_of_shape(arguments, shape)
    write_detections(arguments.out, detections, {"sensor": arguments.sensor, **about})


def _hits(
    arguments: argparse.Namespace, feet_m: Floats, shape: Shape
) -> Iterator[tuple[str, Floats, NDArray]]:
    """Candidates in the order of their depth maps, where they are, and their beams on targets."""
    stride = arguments.azimuth_stride
    sensor = load_sensor(arguments.sensors, arguments.sensor).thinned(stride)
    poses = read_poses(arguments.candidates)
    size_m = shape if isinstance(shape, Box) else (shape.radius_m, shape.height_m)
    tilts = read_tilts(arguments.tilts)
    sight = sight_of(arguments, arguments.sensor, sensor)
    maps = _depth_maps(arguments, sensor)
    for name, depth in logged(maps, len(maps), log, "candidates"):
        if name not in poses:
            raise InputError(
                f"has depth maps of the unknown candidate {name!r}",
                where=arguments.depth,
                hint=f"render it again for {arguments.candidates}",
            )
        *position_m, yaw_deg = poses[name]
        pose = (np.array(position_m), yaw_deg)
        beams = count_beams(depth, sensor, *pose, feet_m, size_m, sight, tilts.get(name))
        yield name, pose[0], stride * beams


def _table(names: list[str], hits: list[pd.Series], targets: pd.Series) -> pd.DataFrame:
    """Rows by candidate and target from the beams on each candidate's seen targets."""
    candidate = np.repeat(np.arange(len(names)), [len(part) for part in hits])
    together = pd.concat([pd.Series(dtype=np.int32), *hits])
    return pd.DataFrame(
        {
            "candidate": pd.Categorical.from_codes(candidate, pd.Index(names, dtype=str)),
            "target": pd.Categorical.from_codes(
                together.index.to_numpy(np.int64), pd.Index(targets, dtype=str)
            ),
            "hits": together.to_numpy(np.uint16),
        }
    )


def _depth_maps(arguments: argparse.Namespace, sensor: Sensor) -> DepthMaps:
    maps = DepthMaps(arguments.depth)
    found = (maps.info.sensor, maps.info.rows, maps.info.columns)
    if found != (arguments.sensor, *sensor.shape):
        raise InputError(
            "is of another sensor",
            where=arguments.depth,
            found=f"{found[0]}, {found[1]} x {found[2]} beams",
            allowed=f"{arguments.sensor}, {sensor.rows} x {sensor.columns} beams",
            hint="delete it and run the workflow again",
        )
    return maps


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_detection_arguments(parser)
    parser.add_argument("--azimuth-stride", type=int, default=1, help="beams that each stands for")
    return run_stage(parser, build_detection_shard, argv)


if __name__ == "__main__":
    sys.exit(main())
