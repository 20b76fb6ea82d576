"""A cloud in memory, in its own order, with the frame that its coordinates mean."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Overlap
from roadsight.geometry.crs import Unit
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.chunks import OVERLAP_CLASS, key_steps, noisy, point_keys
from roadsight.io.cloud.cloud_scan import OVERLAP
from roadsight.io.cloud.clouds import WAVEFORM, NativeCloud, read_laz, write_laz
from roadsight.stages.scene.ingest_cloud import notes_of, survey

log = logging.getLogger("roadsight")


@dataclass(frozen=True)
class Cloud:
    """A whole cloud in its own order.

    Parameters
    ----------
    native : as read, all dimensions. frame : its local frame.
    choice, overlap : what was said of its CRS and units, and of overlap points.
    all_xyz_m : (n, 3) local metres. taken : numbers (k,) of the points that take part.
    like : (n,) the point that each one equals, itself where there is none before it.
    """

    native: NativeCloud
    frame: Frame
    choice: UnitChoice
    overlap: Overlap
    all_xyz_m: Floats
    taken: Ints
    like: Ints

    @property
    def xyz_m(self) -> Floats:
        """Points (k, 3) that take part, local metres."""
        return self.all_xyz_m[self.taken]

    @property
    def intensity(self) -> Floats:
        """Intensity (k,) of the points that take part, as stored."""
        return np.asarray(self.native.dims["intensity"], np.float64)[self.taken]

    @property
    def scan(self) -> Ints:
        """Scan or flight line (k,) of the points that take part: their point source ID."""
        return np.asarray(self.native.dims["point_source_id"], np.int64)[self.taken]

    @property
    def classes(self) -> Bytes:
        """Classification (k,) of the points that take part, as the file has it."""
        return np.asarray(self.native.dims["classification"], np.uint8)[self.taken]

    @property
    def where(self) -> str:
        """The file, for messages."""
        return str(self.native.header.path)


# A cloud that was read, the path of one, or local metres: an array (n, 3) or columns x, y, z.
Points = Cloud | pd.DataFrame | ArrayLike | str | os.PathLike[str]


@dataclass(frozen=True)
class Taken:
    """What functions need of a cloud, whatever it was given as.

    Parameters
    ----------
    xyz_m : (n, 3) local metres. intensity, scan : (n,), None where an array was given.
    frame : what local metres mean, None where an array was given. where : for messages.
    classes : (n,) of the file, None where an array was given.
    """

    xyz_m: Floats
    intensity: Floats | None = None
    scan: Ints | None = None
    frame: Frame | None = None
    where: str = "points"
    classes: Bytes | None = None


def taken(points: Points) -> Taken:
    """Points of a cloud, a path, a table or an array.

    Raises
    ------
    InputError : the file cannot be read, a column is missing, or the array is no (n, 3) of finite
        numbers.
    """
    if isinstance(points, (str, os.PathLike)):
        points = read_cloud(points)
    if isinstance(points, Cloud):
        return Taken(
            points.xyz_m, points.intensity, points.scan, points.frame, points.where, points.classes
        )
    if isinstance(points, pd.DataFrame):
        missing = [name for name in "xyz" if name not in points]
        if missing:
            raise InputError(
                "has no such column", where="points", found=missing[0], allowed="columns x, y, z"
            )
        points = points[list("xyz")]
    try:
        xyz_m = np.asarray(points, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"is no array of numbers ({error})", where="points") from error
    if xyz_m.ndim != 2 or xyz_m.shape[1] != 3 or not len(xyz_m) or not np.isfinite(xyz_m).all():
        raise InputError(
            "is no cloud",
            where="points",
            found=f"shape {xyz_m.shape}, {int((~np.isfinite(xyz_m)).sum())} values not finite",
            allowed="(n, 3) finite local metres, n at least 1",
        )
    return Taken(xyz_m)


def read_cloud(
    path: str | os.PathLike[str],
    *,
    crs: str = "auto",
    units: Unit = "auto",
    vertical_units: Unit = "auto",
    overlap: Overlap = OVERLAP,
) -> Cloud:
    """Read a LAS or LAZ file; without any CRS its coordinates are taken as local metres.

    Noise, withheld and synthetic points, and what is there twice, take no part. Fields are those
    of the LAS specification 1.4.

    Parameters
    ----------
    path : the file.
    crs : auto (the file's own, else local), local, EPSG:nnnn or WKT.
    units, vertical_units : metre, foot, us-survey-foot, or auto: those of the CRS.
    overlap : "use" or "leave_out" points of overlapping flight lines.

    Returns
    -------
    ``xyz_m`` (n, 3) local metres, ``intensity``, ``scan`` and ``classes`` (n,) of the points that
    take part; ``frame``, whose ``to_native`` and ``to_local`` turn local metres into the file's
    coordinates and back

    Raises
    ------
    InputError : the file cannot be read, or its CRS and units contradict each other.

    Examples
    --------
    >>> import laspy, numpy as np, roadsight
    >>> plot = laspy.create()
    >>> plot_m = np.random.default_rng(1).uniform(0, 9, (3, 500))
    >>> plot.x, plot.y, plot.z = plot_m + [[500_000], [5_400_000], [100]]
    >>> plot.write("plot.las")
    >>> cloud = roadsight.read_cloud("plot.las", crs="EPSG:25832")
    >>> native = cloud.frame.to_native(cloud.xyz_m)
    >>> native.shape, bool(np.allclose(native[:, 0], plot.x))
    ((500, 3), True)
    """
    path = Path(path)
    native = read_laz(path)
    choice = UnitChoice(crs, units, vertical_units)
    if crs == "auto" and native.header.stated.crs is None:
        log.warning("%s names no CRS: read as local coordinates", path)
        units = "metre" if units == "auto" else units
        choice = UnitChoice("local", units, vertical_units)
    site, scans, _ = survey([path], choice, overlap=overlap)
    for note in notes_of(site, scans):
        log.warning("%s", note)
    if native.header.left_out:
        log.warning("fields that no record describes are left out of %s", path)
    counts = takes_part(native, overlap)
    like = _first_like(native, counts)
    repeated = int(np.count_nonzero(like != np.arange(len(like))))
    if repeated:
        log.warning("%d points are there twice and count once", repeated)
    taken = np.flatnonzero(counts & (like == np.arange(len(like))))
    return Cloud(native, site.frame, choice, overlap, site.frame.to_local(native.xyz), taken, like)


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


def write_labelled(path: str | Path, cloud: Cloud, labels: Bytes) -> None:
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


def labels_of(cloud: Cloud, ground: Bools, road: Bools | None = None) -> Bytes:
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
