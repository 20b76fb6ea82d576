"""Pavement against truth: per ground point, and how far the outlines lie apart."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import shapely

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError


@dataclass(frozen=True)
class BinaryScores:
    """Scores of a two-class result, shares from 0 to 1; NaN-free: empty classes score 0."""

    accuracy: float
    precision: float
    recall: float
    f1: float
    points: int


def binary_scores(found: Bools, true: Bools) -> BinaryScores:
    """Accuracy, precision, recall and F1 of ``found`` against ``true``, both (n,)."""
    hits = int((found & true).sum())
    precision = hits / max(int(found.sum()), 1)
    recall = hits / max(int(true.sum()), 1)
    f1 = 2 * precision * recall / max(precision + recall, 1e-12)
    accuracy = int((found == true).sum()) / max(len(true), 1)
    return BinaryScores(accuracy, precision, recall, f1, len(true))


def outline_distances_m(outline: shapely.Geometry, other: shapely.Geometry) -> Floats:
    """Distance from points every half metre on an outline to another polygon's outline.

    No points on an empty outline; NaN if the other one is empty.
    """
    if outline.is_empty:
        return np.empty(0)
    points = [
        shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, 0.5))
        for ring in shapely.get_parts(outline.boundary)
    ]
    return shapely.distance(np.concatenate(points), other.boundary)


def pavement_scores(
    xy_m: Floats, found: shapely.Geometry, true: shapely.Geometry, reach_m: float
) -> dict[str, float | int | None]:
    """Scores of a found pavement.

    Truth often covers a part of the scene only; what lies further from it than ``reach_m`` is
    unknown and does not count.

    Parameters
    ----------
    xy_m : (n, 2) ground points, local metres. found, true : polygons, local metres.
    reach_m : distance from the true pavement up to which a point counts; infinite for all.

    Returns
    -------
    accuracy, precision, recall, f1, points; intersection over union of the areas within reach;
    median and 90th percentile of the distance from the found outline (within reach) to the true
    one, None if there is none; share of the true outline over ground points that has found outline
    within 1 m.

    Raises
    ------
    InputError : the truth has no area over the ground points.
    """
    true = _polygons(true.intersection(shapely.convex_hull(shapely.multipoints(xy_m))))
    if true.is_empty:
        raise InputError(
            "the true pavement lies outside the cloud", hint="check its CRS (truth.pavement_crs)"
        )
    if np.isfinite(reach_m):
        known = true.buffer(reach_m)
        shapely.prepare(known)
        xy_m = xy_m[shapely.contains_xy(known, *xy_m.T)]
        found = _polygons(found.intersection(known))
    shapely.prepare([found, true])
    scores = binary_scores(shapely.contains_xy(found, *xy_m.T), shapely.contains_xy(true, *xy_m.T))
    off = outline_distances_m(found, true)
    off = off[off < reach_m * (1 - 1e-6)]
    missed = outline_distances_m(true, found)
    return {
        **asdict(scores),
        "area_iou": found.intersection(true).area / found.union(true).area,
        "outline_median_m": float(np.median(off)) if len(off) else None,
        "outline_p90_m": float(np.percentile(off, 90)) if len(off) else None,
        "outline_found_within_1m": float((missed <= 1.0).mean()),
        "reach_m": reach_m if np.isfinite(reach_m) else None,
    }


def _polygons(geometry: shapely.Geometry) -> shapely.Geometry:
    """What of a geometry has area, without the lines and points that a cut may leave."""
    return shapely.union_all([part for part in shapely.get_parts(geometry) if part.area > 0])
