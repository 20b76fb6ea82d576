"""Scores of camera poses and of pavement against known ones."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg

YAW_DEG = 0.1  # Largest error of heading of a camera that counts as right.
# Largest error of the road's edges across themselves of a camera that counts as right, px.
PIXELS = 2.0
# Nearest edge points that are compared; nearer ones leap where a camera is a little off.
NEAREST_M = 8.0
FARTHEST_M = 80.0  # Farthest edge points that are compared; those beyond crowd within few pixels.
_ALONG_M = 0.1  # Step along an edge by which its direction in the image is told.


def camera_errors(
    cameras: pd.DataFrame, truth: pd.DataFrame, edges_m: Floats, tangents: Floats
) -> pd.DataFrame:
    """Errors of each camera whose true pose is known.

    Parameters
    ----------
    cameras : image, x, y, z (local metres), heading_deg, pitch_deg, roll_deg, focal_px, cx_px,
        cy_px, width_px, height_px, accepted.
    truth : the same without ``accepted``.
    edges_m : (n, 3) road edge points. tangents : (n, 2) their directions in plan.

    Returns
    -------
    image, accepted, yaw_deg, pitch_deg, roll_deg, along_m, right_m, up_m, focal_ratio, point_px
    (median distance of road edge points 8 to 80 m away under both poses), edge_px (the part of it
    across the edge)
    """
    both = cameras.merge(truth, on="image", suffixes=("", "_true"))
    level = np.pad(tangents, ((0, 0), (0, 1)))
    rows = []
    for _, row in both.iterrows():
        angles = ("heading", "pitch", "roll")
        turn = [float(wrap_deg(row[f"{a}_deg"] - row[f"{a}_deg_true"])) for a in angles]
        heading = np.radians(row["heading_deg_true"])
        east, north, up = (row[axis] - row[f"{axis}_true"] for axis in "xyz")
        along = east * np.sin(heading) + north * np.cos(heading)
        right = east * np.cos(heading) - north * np.sin(heading)
        focal = row["focal_px"] / row["focal_px_true"]
        rows.append([*turn, along, right, up, focal, *_pixel_errors(row, edges_m, level)])
    names = ("yaw_deg", "pitch_deg", "roll_deg", "along_m", "right_m", "up_m", "focal_ratio")
    found = pd.DataFrame(rows, columns=[*names, "point_px", "edge_px"], dtype=float)
    return pd.concat([both[["image", "accepted"]], found], axis=1)


def _pixel_errors(row: pd.Series, edges_m: Floats, tangents: Floats) -> tuple[float, float]:
    """Median distance of edge points under both poses, and its part across the edge."""
    apart = np.hypot(edges_m[:, 0] - row["x_true"], edges_m[:, 1] - row["y_true"])
    near = (apart >= NEAREST_M) & (apart <= FARTHEST_M)
    points, ahead = edges_m[near], edges_m[near] + _ALONG_M * tangents[near]
    lens, true = _pose(row, "_true")
    uv_true, _ = project(lens, *true, points)
    uv_next, _ = project(lens, *true, ahead)
    found_lens, found = _pose(row, "")
    uv, _ = project(found_lens, *found, points)
    seen = lens.contains(uv_true) & np.isfinite(uv).all(axis=1)
    if not seen.any():
        return float("nan"), float("nan")
    gap, line = (uv - uv_true)[seen], (uv_next - uv_true)[seen]
    length = np.hypot(*line.T)
    with np.errstate(invalid="ignore", divide="ignore"):
        across = np.abs(gap[:, 0] * line[:, 1] - gap[:, 1] * line[:, 0]) / length
    return float(np.median(np.hypot(*gap.T))), float(np.nanmedian(across))


def _pose(row: pd.Series, suffix: str) -> tuple[Intrinsics, tuple[Floats, Floats]]:
    def value(name: str) -> float:
        return float(row[f"{name}{suffix}"])

    size = int(row["width_px"]), int(row["height_px"])
    lens = Intrinsics(*size, value("focal_px"), value("cx_px"), value("cy_px"))
    angles = (value(f"{name}_deg") for name in ("heading", "pitch", "roll"))
    return lens, (cam_from_world(*angles), np.array([value(axis) for axis in "xyz"]))


def camera_scores(errors: pd.DataFrame, images: int) -> dict[str, Any]:
    """Shares and percentiles of the errors of accepted cameras.

    Parameters
    ----------
    errors : as `camera_errors`. images : all images of the site, scored or not.
    """
    good = errors[errors["accepted"].to_numpy(bool)]
    right = (good["yaw_deg"].abs() <= YAW_DEG) & (good["edge_px"] <= PIXELS)
    return {
        "images": images,
        "known": len(errors),
        "accepted": len(good),
        "within_limits": int(right.sum()),
        "limits": {"yaw_deg": YAW_DEG, "edge_px": PIXELS},
        "share_of_images_within_limits": _share(right.sum(), len(errors)),
        "share_of_accepted_within_limits": _share(right.sum(), len(good)),
        "share_of_accepted_within_yaw_limit": _share(
            (good["yaw_deg"].abs() <= YAW_DEG).sum(), len(good)
        ),
        "errors": {name: _spread(good[name]) for name in errors.columns[2:]},
    }


def _share(part: float, whole: int) -> float | None:
    return float(part) / whole if whole else None


def _spread(values: pd.Series) -> dict[str, float] | None:
    """Mean, and median and 90th percentile of the absolute values; None without values."""
    known = values.dropna().to_numpy(np.float64)
    if not len(known):
        return None
    median, high = np.percentile(np.abs(known), [50, 90])
    return {"mean": float(known.mean()), "median_abs": float(median), "p90_abs": float(high)}


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
