"""Which targets a sensor sees from the candidates of one shard."""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Lidar
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.kept import Kept, key_of, key_of_step
from roadsight.io.records.placement_tables import (
    read_detections,
    read_poses,
    read_tilts,
    read_traffic,
    write_detections,
)
from roadsight.placement.sensors.sensors import Sensor, load_sensor, what_it_sees
from roadsight.placement.sight.kinds import Box
from roadsight.placement.sight.lanes import free_shares
from roadsight.placement.sight.sight import count_beams
from roadsight.stages.command import Command, logged
from roadsight.stages.placement.shared.detection_inputs import (
    DetectionFiles,
    read_shaped_targets,
    said_of_shape,
    sight_of,
)

log = logging.getLogger("build_detection_shard")

_MOST_HITS = np.iinfo(np.uint16).max
"""Hits are written in 16 bits; what is nearer than that many need not be told apart."""


@dataclass(frozen=True, kw_only=True)
class ShardFiles(DetectionFiles):
    """A shard of depth maps and what is looked for in them."""

    azimuth_stride: Annotated[int, Lidar]
    kept: Annotated[Path | None, "rows of an earlier run, taken over where nothing changed"] = None


def build_detection_shard(given: ShardFiles, *, out: Path) -> None:
    """Write a row for each target seen, by candidate and then by target."""
    targets, feet_m, shape = read_shaped_targets(given)
    traffic = read_traffic(given.lanes[0]) if given.lanes else None
    stride = given.azimuth_stride
    sensor = load_sensor(given.sensors, given.sensor).thinned(stride)
    maps, poses = _depth_maps(given, sensor), read_poses(given.candidates)
    tilts = read_tilts(given.tilts)
    keys = _keys(given, maps, poses, tilts)
    kept = Kept(given.kept, _step(given, sensor) if given.kept else "")
    known = kept.names(keys)
    log.info("%d of %d candidates are those of an earlier run", len(known), len(keys))
    old = _earlier(kept, known, targets["target"])
    size_m = shape if isinstance(shape, Box) else (shape.radius_m, shape.height_m)
    sight = sight_of(given, given.sensor, sensor)
    new = maps.only(set(keys) - known) if known else iter(maps)
    names, hits, free = [], [], []
    for name in logged(list(keys), len(keys), log, "candidates"):
        names.append(name)
        if name in known:
            hits.append(old[name]["hits"])
            if traffic is not None:
                free.append(old[name]["availability"].to_numpy())
            continue
        found, depth = next(new)
        if found != name:
            raise InputError("holds its maps in another order", where=str(given.depth))
        *place, yaw_deg = poses[name]
        pose = (np.array(place), yaw_deg)
        beams = stride * count_beams(depth, sensor, *pose, feet_m, size_m, sight, tilts.get(name))
        seen = np.flatnonzero(beams > given.min_beams)
        if traffic is not None:
            middles = feet_m[seen, :3] + np.array([0.0, 0.0, shape.height_m / 2])
            shares = free_shares(traffic.lanes, pose[0], middles)
            often = shares >= traffic.availability
            seen = seen[often]
            free.append(shares[often])
        counts = np.ceil(beams[seen]).astype(np.int32)
        hits.append(pd.Series(np.minimum(counts, _MOST_HITS), index=seen))
    detections = _table(names, hits, targets["target"])
    if traffic is not None:
        detections["availability"] = np.concatenate([[], *free]).astype(np.float32)
    log.info("%d candidates, %d targets, %d seen", len(names), len(targets), len(detections))
    about = said_of_shape(given, shape)
    write_detections(out, detections, {"sensor": given.sensor, **about})
    kept.keep(out, keys)


def _keys(
    given: ShardFiles, maps: DepthMaps, poses: dict[str, Floats], tilts: dict[str, Floats]
) -> dict[str, str]:
    """Key of what each candidate's row rests on: map, pose and tilt; in the maps' order."""
    keys = {}
    for name in maps.candidates():
        if name not in poses:
            raise InputError(
                f"has depth maps of the unknown candidate {name!r}",
                where=str(given.depth),
                hint=f"render it again for {given.candidates}",
            )
        keys[name] = ""
    if given.kept:
        for name, stored in maps.stored(keys):
            tilt = tilts.get(name)
            leaning = None if tilt is None else tilt.tolist()
            keys[name] = key_of(stored, poses[name].tolist(), leaning)
    return keys


def _step(given: ShardFiles, sensor: Sensor) -> str:
    """Key of all that the rows of a shard rest on, beside the candidates and their maps."""
    files = [given.targets, *given.air, *given.reflectivity, *given.lanes]
    names = ("radius_m", "height_m", "box", "min_beams", "azimuth_stride", "partial_hits")
    settings = [getattr(given, name) for name in (*names, "curvature")]
    return key_of_step(files, given.sensor, what_it_sees(sensor), settings)


def _earlier(kept: Kept, known: set[str], targets: pd.Series) -> dict[str, pd.DataFrame]:
    """Rows of an earlier run by candidate, with the numbers of their targets as index."""
    empty = pd.DataFrame({"hits": np.empty(0, np.int32), "availability": np.empty(0)})
    rows = dict.fromkeys(known, empty)
    if not known:
        return rows
    table = read_detections([kept.path])
    number = pd.Series(np.arange(len(targets)), index=targets.astype(str))
    table.index = number.reindex(table["target"].astype(str)).to_numpy()
    for name, part in table.groupby(table["candidate"].astype(str), sort=False):
        if name in rows:
            rows[str(name)] = part
    return rows


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


def _depth_maps(given: ShardFiles, sensor: Sensor) -> DepthMaps:
    maps = DepthMaps(given.depth)
    found = (maps.info.sensor, maps.info.rows, maps.info.columns)
    if found != (given.sensor, *sensor.shape):
        raise InputError(
            "is of another sensor",
            where=str(given.depth),
            found=f"{found[0]}, {found[1]} x {found[2]} beams",
            allowed=f"{given.sensor}, {sensor.rows} x {sensor.columns} beams",
            hint="delete it and run the workflow again",
        )
    return maps


main = Command(build_detection_shard)


if __name__ == "__main__":
    sys.exit(main())
