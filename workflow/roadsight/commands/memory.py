"""A cloud in memory and what the scene stages find in it; for the verbs, which take one file."""

from __future__ import annotations

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.clouds import WAVEFORM, NativeCloud, read_laz, write_laz
from roadsight.io.cloud.point_filter import (
    OVERLAP_CLASS,
    OVERLAPS,
    key_steps,
    noisy,
    point_keys,
)
from roadsight.scene.terrain.ground_settings import GroundSettings
from roadsight.scene.whole import (
    FoundRoad,
    ground_of,
    published_road,
    road_of,
    scans_tell,
    spacing_of,
)
from roadsight.stages.scene.ingest_cloud import UNITS, notes_of, survey

log = logging.getLogger("roadsight")

_SAMPLE = 100_000
"""Points that the classes of a cloud are learnt from; all of a smaller cloud."""


@dataclass(frozen=True)
class MemoryCloud:
    """A whole cloud in its own order.

    Parameters
    ----------
    native : as read, all dimensions. frame : its local frame.
    all_xyz_m : (n, 3) local metres. taken : numbers (k,) of the points that take part.
    like : (n,) the point that each one equals, itself where there is none before it.
    """

    native: NativeCloud
    frame: Frame
    all_xyz_m: Floats
    taken: Ints
    like: Ints

    @property
    def xyz_m(self) -> Floats:
        """Points (k, 3) that take part, local metres."""
        return self.all_xyz_m[self.taken]

    @property
    def spacing_m(self) -> float:
        """Spacing of evenly spread points of this density."""
        return spacing_of(self.xyz_m)


def add_cloud_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that every verb on a cloud takes."""
    parser.add_argument("cloud", metavar="CLOUD", type=Path, help="LAS or LAZ file")
    parser.add_argument(
        "--crs", default="auto", help="EPSG:nnnn, local, or auto: the file's own, else local"
    )
    parser.add_argument("--units", choices=UNITS, default="auto", help="unit of x and y")
    parser.add_argument("--vertical-units", choices=UNITS, default="auto", help="unit of z")
    parser.add_argument(
        "--overlap",
        choices=OVERLAPS,
        default="use",
        help="points of overlapping flight lines; noise, withheld and synthetic ones never count",
    )


def check_output(arguments: argparse.Namespace, *suffixes: str) -> None:
    """Check the output's name before any work is done.

    Raises
    ------
    InputError : it is of another kind, or is the cloud itself.
    """
    out = Path(arguments.out)
    if out.suffix.lower() not in suffixes:
        raise InputError(
            "is no name for what this verb writes",
            where=f"--out {out}",
            allowed=", ".join(suffixes),
        )
    if out.resolve() == arguments.cloud.resolve():
        raise InputError("is the cloud itself", where=f"--out {out}", hint="choose another name")


def load_cloud(arguments: argparse.Namespace) -> MemoryCloud:
    """Read the verb's cloud; without any CRS its coordinates are taken as local metres."""
    native = read_laz(arguments.cloud)
    choice = UnitChoice(arguments.crs, arguments.units, arguments.vertical_units)
    if arguments.crs == "auto" and native.header.stated.crs is None:
        log.warning("%s names no CRS: read as local coordinates", arguments.cloud)
        units = "metre" if arguments.units == "auto" else arguments.units
        choice = UnitChoice("local", units, arguments.vertical_units)
    site, scans, _ = survey([arguments.cloud], choice, overlap=arguments.overlap)
    for note in notes_of(site, scans):
        log.warning("%s", note)
    if native.header.left_out:
        log.warning("fields that no record describes are left out of %s", arguments.cloud)
    counts = takes_part(native, arguments.overlap)
    like = _first_like(native, counts)
    repeated = int(np.count_nonzero(like != np.arange(len(like))))
    if repeated:
        log.warning("%d points are there twice and count once", repeated)
    taken = np.flatnonzero(counts & (like == np.arange(len(like))))
    return MemoryCloud(native, site.frame, site.frame.to_local(native.xyz), taken, like)


def takes_part(native: NativeCloud, overlap: str) -> Bools:
    """Points (n,) that take part, by the same filter as `kept_chunks`."""
    dims = native.dims
    left_out = noisy(np.asarray(dims["classification"]))
    left_out |= np.asarray(dims["withheld"], bool) | np.asarray(dims["synthetic"], bool)
    if overlap == "leave_out":
        flagged = dims.get("overlap")
        left_out |= (
            np.asarray(dims["classification"]) == OVERLAP_CLASS
            if flagged is None
            else np.asarray(flagged, bool)
        )
    return ~left_out


def _first_like(native: NativeCloud, counts: Bools) -> Ints:
    """Number (n,) of the first point that takes part and equals each one."""
    like, rows = np.arange(len(native.xyz)), np.flatnonzero(counts)
    dims = native.dims
    keys = point_keys(
        native.xyz,
        key_steps(native.header.scale),
        dims.get("gps_time"),
        np.asarray(dims["return_number"]),
        np.asarray(dims["intensity"]),
    )[rows]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    like[rows] = rows[first[inverse]]
    return like


def write_labelled(path: str, cloud: MemoryCloud, labels: Bytes) -> None:
    """Write the cloud with other classes, everything else but waveforms as it was."""
    if set(WAVEFORM) & set(cloud.native.dims):
        log.warning(
            "waveforms are left out of %s: points name places in the waveform data of %s (.wdp,"
            " or in the file), which is not written anew; all other fields are kept",
            path,
            cloud.native.header.path,
        )
    dims = {**cloud.native.dims, "classification": labels}
    write_laz(path, cloud.all_xyz_m, cloud.frame, dims, cloud.native.header.carried)


def ground_labels(cloud: MemoryCloud, settings: GroundSettings | None = None) -> Bools:
    """Ground labels (k,) of the points that take part, in the file's order.

    Raises
    ------
    InputError : nothing lies near a plausible ground.
    """
    mask = ground_of(cloud.xyz_m, settings)
    if not mask.any():
        raise InputError("no ground found", where=str(cloud.native.header.path))
    return mask


def pavement_of(cloud: MemoryCloud, ground: Bools, arguments: argparse.Namespace) -> FoundRoad:
    """Pavement by the way that the verb asks for, or that the cloud allows.

    Raises
    ------
    InputError : no pavement is found.
    """
    scan = np.asarray(cloud.native.dims["point_source_id"], np.int64)[cloud.taken]
    method = arguments.method
    if method == "auto":
        method = "surface" if scans_tell(cloud.xyz_m, scan) else "published"
        log.info("pavement by method %s", method)
    intensity = np.asarray(cloud.native.dims["intensity"], np.float64)[cloud.taken]
    try:
        if method == "surface":
            use = None if arguments.intensity == "ignore" else intensity
            return road_of(cloud.xyz_m, use, scan)[0]
        return published_road(cloud.xyz_m, ground, intensity, arguments.intensity, arguments.seed)
    except InputError as error:
        raise InputError(str(error), where=str(cloud.native.header.path)) from error


def labels_of(cloud: MemoryCloud, ground: Bools, road: Bools | None = None) -> Bytes:
    """Classification: the file's own where it is neither ground nor road, 2 ground, 11 road.

    The file's own ground and road labels give way to what was found; they become 1, unclassified.
    Points that take no part keep their class; one that is there twice is labelled twice.
    """
    labels = np.asarray(cloud.native.dims["classification"], np.uint8).copy()
    own = labels[cloud.taken]
    own[np.isin(own, (2, 11))] = 1
    own[ground] = 2
    if road is not None:
        own[road] = 11
    labels[cloud.taken] = own
    return labels[cloud.like]
