"""Pavement against truth: per ground point, and how far the outlines lie apart."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import shapely
from numpy.typing import NDArray


@dataclass(frozen=True)
class BinaryScores:
    """Scores of a two-class result, shares from 0 to 1; NaN-free: empty classes score 0."""

    accuracy: float
    precision: float
    recall: float
    f1: float
    points: int


def binary_scores(found: NDArray[np.bool_], true: NDArray[np.bool_]) -> BinaryScores:
    """Accuracy, precision, recall and F1 of ``found`` against ``true``, both (n,)."""
    hits = int((found & true).sum())
    precision = hits / max(int(found.sum()), 1)
    recall = hits / max(int(true.sum()), 1)
    f1 = 2 * precision * recall / max(precision + recall, 1e-12)
    return BinaryScores(float((found == true).mean()), precision, recall, f1, len(true))


def outline_distances_m(found: shapely.Geometry, true: shapely.Geometry) -> NDArray[np.float64]:
    """Distance from points every half metre on the found outline to the true outline."""
    points = [
        shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, 0.5))
        for ring in shapely.get_parts(found.boundary)
    ]
    return shapely.distance(np.concatenate(points), true.boundary)


def pavement_scores(
    xy_m: NDArray[np.float64], found: shapely.Geometry, true: shapely.Geometry
) -> dict[str, float | int]:
    """Scores of a found pavement.

    Parameters
    ----------
    xy_m : (n, 2) ground points, local metres. found, true : polygons, local metres.

    Returns
    -------
    accuracy, precision, recall, f1, points; intersection over union of the areas; the median and
    90th percentile of the outline's distance.
    """
    shapely.prepare([found, true])
    scores = binary_scores(shapely.contains_xy(found, *xy_m.T), shapely.contains_xy(true, *xy_m.T))
    distance = outline_distances_m(found, true)
    return {
        **asdict(scores),
        "area_iou": found.intersection(true).area / found.union(true).area,
        "outline_median_m": float(np.median(distance)),
        "outline_p90_m": float(np.percentile(distance, 90)),
    }
