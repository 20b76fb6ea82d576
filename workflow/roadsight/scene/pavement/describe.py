"""Thinned ground points with everything that tells pavement from rough ground."""

from __future__ import annotations

from dataclasses import dataclass

from roadsight.base.arrays import Floats, Floats32
from roadsight.base.engines import OWN, Engine
from roadsight.base.sections.scene import GroundClasses, Thinning
from roadsight.scene.pavement.fpfh import fpfh
from roadsight.scene.pavement.normals import nearest_neighbours, upward_normals
from roadsight.scene.pavement.open3d_engine import open3d_fpfh, open3d_normals
from roadsight.scene.pavement.smoothness import local_intensity
from roadsight.scene.surfels.thinning import column_means

_USUAL = GroundClasses().thinning


@dataclass(frozen=True)
class GroundDescription:
    """Thinned ground points.

    Parameters
    ----------
    xyz_m : (n, 3) centroids of columns or cubes, local metres.
    intensity : (n,) median around each. variation : (n,) surface variation, NaN where unknown.
    histograms : (n, 33) FPFH.
    """

    xyz_m: Floats
    intensity: Floats
    variation: Floats
    histograms: Floats32


def describe_ground(
    xyz_m: Floats,
    intensity: Floats,
    column_m: float,
    neighbours: int,
    engine: Engine = OWN,
    thinning: Thinning = _USUAL,
) -> GroundDescription:
    """Thin ground points to columns or cubes and describe each.

    Parameters
    ----------
    xyz_m : (n, 3) ground points; intensity : (n,). neighbours : K1.
    engine : who computes normals and histograms.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    centroid, mean, _ = column_means(xyz_m, intensity[:, None], column_m, thinning)
    distance, near = nearest_neighbours(centroid, neighbours)
    if engine == "own":
        normals, variation = upward_normals(centroid, near)
        histograms = fpfh(centroid, normals, distance, near)
    else:
        normals, variation = open3d_normals(centroid, neighbours)
        histograms = open3d_fpfh(centroid, normals, neighbours)
    return GroundDescription(centroid, local_intensity(mean[:, 0], near), variation, histograms)
