"""A cloud in memory and what the scene stages find in it; for the verbs, which take one file."""

from __future__ import annotations

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from shapely import MultiPolygon

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.clouds import NativeCloud, read_laz
from roadsight.scene.pavement.describe import GroundDescription, describe_ground
from roadsight.scene.pavement.outline import (
    PavementSettings,
    inside,
    outline_pavement,
    pavement_settings_for,
)
from roadsight.scene.pavement.smoothness import fit_smoothness, is_smooth
from roadsight.scene.spacing import uses_intensity
from roadsight.scene.terrain.ground_settings import GroundSettings
from roadsight.scene.whole import ground_of, spacing_of
from roadsight.stages.scene.ingest_cloud import UNITS, survey

log = logging.getLogger("roadsight")

_SAMPLE = 100_000
"""Points that the classes of a cloud are learnt from; all of a smaller cloud."""


@dataclass(frozen=True)
class MemoryCloud:
    """A whole cloud in its own order.

    Parameters
    ----------
    native : as read, all dimensions. frame : its local frame. xyz_m : (n, 3) local metres.
    """

    native: NativeCloud
    frame: Frame
    xyz_m: Floats

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
    site, _, _ = survey([arguments.cloud], choice)
    return MemoryCloud(native, site.frame, site.frame.to_local(native.xyz))


def labelled_ground(cloud: MemoryCloud, settings: GroundSettings | None = None) -> Bools:
    """Ground labels in the file's order.

    Raises
    ------
    InputError : the cloud has no ground.
    """
    mask = ground_of(cloud.xyz_m, settings)
    if not mask.any():
        raise InputError("no ground found", where=str(cloud.native.header.path))
    return mask


def pavement_of(
    cloud: MemoryCloud, ground: Bools, intensity_choice: str, seed: int
) -> tuple[MultiPolygon, GroundDescription]:
    """Outline of the pavement and the thinned ground that it was found on."""
    spacing_m = cloud.spacing_m
    column_m = max(0.1, spacing_m)
    intensity = np.asarray(cloud.native.dims["intensity"], np.float64)[ground]
    description = describe_ground(cloud.xyz_m[ground], intensity, column_m, neighbours=10)
    rng = np.random.default_rng(seed)
    count = len(description.variation)
    rows = np.sort(rng.choice(count, min(_SAMPLE, count), replace=False))
    use = uses_intensity(intensity_choice, spacing_m) and len(np.unique(intensity)) > 1
    model = fit_smoothness(
        description.histograms[rows],
        description.variation[rows],
        description.intensity[rows] if use else None,
        1.5,
        seed,
    )
    smooth = is_smooth(model, description.histograms, description.variation, description.intensity)
    settings = pavement_settings_for(column_m, PavementSettings())
    try:
        return outline_pavement(description.xyz_m, smooth, settings), description
    except InputError as error:
        raise InputError(str(error), where=str(cloud.native.header.path)) from error


def labels_of(cloud: MemoryCloud, ground: Bools, pavement: MultiPolygon | None) -> Bytes:
    """Classification: the file's own where it is neither ground nor road, 2 ground, 11 road.

    The file's own ground and road labels give way to what was found; they become 1, unclassified.
    """
    labels = np.asarray(cloud.native.dims["classification"], np.uint8).copy()
    labels[np.isin(labels, (2, 11))] = 1
    labels[ground] = 2
    if pavement is not None:
        x, y, _ = cloud.xyz_m.T
        labels[ground & inside(pavement, x, y)] = 11
    return labels
