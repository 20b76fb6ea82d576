"""Which targets a sensor sees from the candidates of one shard in each pose worth keeping."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Targets
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.placement_tables import (
    SiteTraffic,
    read_poses,
    read_tilts,
    read_traffic,
    write_detections,
)
from roadsight.placement.sensors.poses import local_from_sensor, not_dominated, pose_name, turns_of
from roadsight.placement.sensors.sensors import load_sensor, load_sensors
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Shape
from roadsight.placement.sight.lanes import free_shares
from roadsight.placement.sight.posed import Panorama
from roadsight.stages.command import Command, logged
from roadsight.stages.placement.shared.detection_inputs import (
    DetectionFiles,
    read_shaped_targets,
    said_of_shape,
    sight_of,
)

log = logging.getLogger("detect_poses")

_MOST_HITS = np.iinfo(np.uint16).max
"""Hits are written in 16 bits; what is nearer than that many need not be told apart."""


@dataclass(frozen=True, kw_only=True)
class PoseFiles(DetectionFiles):
    """What is tried of a sensor, and what its kind needs to see a target."""

    yaw_deg: Sequence[float]
    pitch_deg: Sequence[float]
    roll_deg: Sequence[float]
    rcs_m2: Annotated[float, Targets]
    min_pixels: Annotated[int | None, "what cameras need, not their definitions'"] = None


def detect_poses(given: PoseFiles, *, out: Path) -> None:
    """Write a row for each target seen, by candidate, pose and target; ``hits`` as measured."""
    targets, feet_m, shape = read_shaped_targets(given)
    traffic = read_traffic(given.lanes[0]) if given.lanes else None
    sensor = load_sensors(given.sensors)[given.sensor]
    turns = turns_of(given.yaw_deg, given.pitch_deg, given.roll_deg)
    detector = detector_of(sensor, Criteria(given.min_beams, given.rcs_m2, given.min_pixels))
    sight = sight_of(given, given.sensor, sensor)
    tilts, parts, tried = read_tilts(given.tilts), [], 0
    for name, panorama in _panoramas(given):
        rotations = [local_from_sensor(panorama.yaw_deg, t, tilts.get(name)) for t in turns]
        measured = np.stack(
            [detector.measure(panorama, turned, feet_m, shape, sight) for turned in rotations]
        )
        seen, shares = _often(detector.sees(measured), panorama, feet_m, shape, traffic)
        tried += len(turns)
        for row in not_dominated(seen):
            found = np.flatnonzero(seen[row])
            part = {"target": found, "hits": np.ceil(measured[row, found])}
            if traffic is not None:
                part["availability"] = shares[found]
            parts.append((pose_name(name, turns[row]), pd.DataFrame(part)))
    log.info("%d of %d poses kept", len(parts), tried)
    about: dict[str, Any] = {**said_of_shape(given, shape)}
    about |= {"sensor": given.sensor, "unit": detector.unit}
    about |= {"poses_tried": tried, "poses_kept": len(parts)}
    names = targets["target"].astype(str)
    write_detections(out, _table(parts, names, traffic is not None), about)


def _often(
    seen: Bools, panorama: Panorama, feet_m: Floats, shape: Shape, traffic: SiteTraffic | None
) -> tuple[Bools, Floats]:
    """What the poses (m, n) see often enough past traffic, and how often (n,)."""
    shares = np.ones(len(feet_m))
    if traffic is None:
        return seen, shares
    any_pose = np.flatnonzero(seen.any(axis=0))
    middles = feet_m[any_pose, :3] + np.array([0.0, 0.0, shape.height_m / 2])
    shares[any_pose] = free_shares(traffic.lanes, panorama.position_m, middles)
    return seen & (shares >= traffic.availability), shares


def _panoramas(given: PoseFiles) -> Iterator[tuple[str, Panorama]]:
    """Candidates in the order of their panoramas."""
    maps, poses = DepthMaps(given.depth), read_poses(given.candidates)
    meant = read_poses(given.candidates, given.sensor)
    beams = load_sensor(given.sensors, maps.info.sensor)
    for name, depth in logged(maps, len(maps), log, "candidates"):
        if name not in poses:
            raise InputError(
                f"has depth maps of the unknown candidate {name!r}",
                where=str(given.depth),
                hint=f"render it again for {given.candidates}",
            )
        if name not in meant:
            continue  # a denser candidate for the gaps of other sensors
        *position_m, yaw_deg = poses[name]
        yield name, Panorama(depth, beams, np.array(position_m), float(yaw_deg))


def _table(
    parts: list[tuple[str, pd.DataFrame]], targets: pd.Series, available: bool
) -> pd.DataFrame:
    """Rows by candidate in a pose and by target."""
    numbers = ["hits", "availability"] if available else ["hits"]
    empty = pd.DataFrame(dtype=np.float64, columns=["target", *numbers])
    rows = pd.concat([empty, *(part for _, part in parts)], ignore_index=True)
    pose = np.repeat(np.arange(len(parts)), [len(part) for _, part in parts])
    names = pd.Index([name for name, _ in parts], dtype=str)
    table = pd.DataFrame(
        {
            "candidate": pd.Categorical.from_codes(pose, names),
            "target": pd.Categorical.from_codes(
                rows["target"].to_numpy(np.int64), pd.Index(targets, dtype=str)
            ),
            "hits": rows["hits"].clip(upper=_MOST_HITS).to_numpy(np.uint16),
        }
    )
    if available:
        table["availability"] = rows["availability"].to_numpy(np.float32)
    return table


main = Command(detect_poses)


if __name__ == "__main__":
    sys.exit(main())
