"""How well masks and relative depth agree with the truth, on arrays."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pole_masks import Instance, find_instances

# What lies beside the road where its border is judged.
_BORDER_OF = (PixelClass.OTHER, PixelClass.VEGETATION)
_FAR_PX = 10.0  # Errors are cut here; a marking further from any other is missed or invented.
_SHARED_HEIGHT = 0.4  # Two poles may be the same if they share this part of their height together.


def confusion(found: Bytes, truth: Bytes, classes: int = len(PixelClass)) -> Ints:
    """Pixels (classes, classes) by true class (rows) and found class (columns)."""
    pairs = truth.astype(np.int64).ravel() * classes + found.ravel()
    return np.bincount(pairs, minlength=classes * classes).reshape(classes, classes)


def scores_by_class(pixels: Ints) -> dict[str, dict[str, float]]:
    """Intersection over union, precision and recall of each class that the truth has."""
    scores = {}
    for kind in PixelClass:
        both = pixels[kind, kind]
        true, found = pixels[kind].sum(), pixels[:, kind].sum()
        if true:
            scores[kind.name.lower()] = {
                "iou": float(both / (true + found - both)),
                "precision": float(both / max(found, 1)),
                "recall": float(both / true),
                "true_share": float(true / pixels.sum()),
            }
    return scores


def road_border_errors(found: Bytes, truth: Bytes, near: Bools) -> Floats:
    """Distance of each true border pixel of the road to the found border, px, at most 10.

    The border parts road with its markings from verge and plants; ``near`` limits where it is
    looked at. Distances are to the nearest pixel in any direction.
    """
    true_border = _road_border(truth) & near
    found_border = _road_border(found)
    if not found_border.any():
        return np.full(np.count_nonzero(true_border), _FAR_PX)
    away = cv2.distanceTransform(
        np.logical_not(found_border).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    return np.minimum(away[true_border].astype(np.float64), _FAR_PX)


def _road_border(mask: Bytes) -> Bools:
    """Pixels of the road beside verge or plants."""
    road = np.isin(mask, (PixelClass.ROAD, PixelClass.MARKING))
    verge = np.isin(mask, _BORDER_OF).astype(np.uint8)
    return road & (cv2.dilate(verge, np.ones((3, 3), np.uint8)) > 0)


def marking_errors(found: Bytes, truth: Bytes, near: Bools) -> tuple[Floats, int, int]:
    """Sideways errors of the middles of markings, row by row.

    Returns
    -------
    Distance of the middle of each true run to that of the nearest found one, px, for those nearer
    than 10 px; number of true runs without one; number of found runs without a true one.
    """
    errors: list[float] = []
    missed = invented = 0
    for row in np.flatnonzero(near.any(axis=1)):
        true, seen = (_middles(mask[row], near[row]) for mask in (truth, found))
        if len(true) and len(seen):
            away = np.abs(true[:, None] - seen)
            nearest = away.min(axis=1)
            errors.extend(nearest[nearest < _FAR_PX])
            missed += int(np.count_nonzero(nearest >= _FAR_PX))
            invented += int(np.count_nonzero(away.min(axis=0) >= _FAR_PX))
        else:
            missed, invented = missed + len(true), invented + len(seen)
    return np.array(errors, np.float64), missed, invented


def _middles(row: Bytes, near: Bools) -> Floats:
    """Middles of the runs of marking pixels that lie on the road near by."""
    inside = np.concatenate([[0], (row == PixelClass.MARKING) & near, [0]]).astype(np.int8)
    change = np.diff(inside)
    ends = np.flatnonzero(change == 1) + np.flatnonzero(change == -1) - 1
    return 0.5 * ends.astype(np.float64)


@dataclass(frozen=True)
class PoleMatches:
    """Poles of one image.

    Parameters
    ----------
    true_m : distance of each true pole. hit : whether it is found. foot_px : distance (du, dv) of
        the found foot from the true one, NaN if not found. false_m : distance of what is seen at
        each found pole that is none.
    """

    true_m: Floats
    hit: Bools
    foot_px: Floats
    false_m: Floats


def match_poles(found: Bytes, truth: Bytes, depth_m: Floats) -> PoleMatches:
    """Match the poles that the pipeline finds in a mask to those it finds in the truth.

    A pole is found if another one's axis runs along it: less than its own width (or 3 px) away
    in the middle of the rows that both have, and those rows are 0.4 of all. Poles that the
    pipeline drops (too small, not slender) do not count on either side.
    """
    true, seen = (_kept(find_instances(mask)) for mask in (truth, found))
    taken: set[int] = set()
    feet = np.full((len(true), 2), np.nan)
    for i, one in enumerate(true):
        for j, other in enumerate(seen):
            if j not in taken and _same(one, other):
                taken.add(j)
                feet[i] = other.u_foot - one.u_foot, other.v_foot - one.v_foot
                break
    false = [one for j, one in enumerate(seen) if j not in taken]
    return PoleMatches(
        np.array([_distance(one, truth, depth_m) for one in true]),
        np.isfinite(feet[:, 0]),
        feet,
        np.array([_distance(one, found, depth_m) for one in false]),
    )


def _kept(instances: list[Instance]) -> list[Instance]:
    return [one for one in instances if not one.reason]


def _same(one: Instance, other: Instance) -> bool:
    top, bottom = max(one.v_min, other.v_min), min(one.v_max, other.v_max)
    whole = max(one.v_max, other.v_max) - min(one.v_min, other.v_min)
    if bottom - top < _SHARED_HEIGHT * whole:
        return False
    middle = np.array(0.5 * (top + bottom))
    return bool(abs(one.axis_u(middle) - other.axis_u(middle)) <= max(one.width_px, 3.0))


def _distance(one: Instance, mask: Bytes, depth_m: Floats) -> float:
    """Median true depth of the object's pixels near its axis; infinite against the sky."""
    rows, columns = axis_pixels(one, mask)
    return float(np.median(depth_m[rows, columns])) if len(rows) else np.inf


def axis_pixels(one: Instance, mask: Bytes, share: float = 1.0) -> tuple[Ints, Ints]:
    """Rows and columns of the pole pixels on the axis, in the lowest ``share`` of the pole."""
    top = one.v_max - share * (one.v_max - one.v_min)
    rows = np.arange(int(np.ceil(top)), int(one.v_max) + 1)
    on_axis = one.axis_u(rows.astype(np.float64))
    columns = np.clip(np.round(on_axis).astype(int), 0, mask.shape[1] - 1)
    rows = np.clip(rows, 0, mask.shape[0] - 1)
    on_pole = mask[rows, columns] == PixelClass.POLE
    return rows[on_pole], columns[on_pole]


def true_poles(mask: Bytes) -> list[Instance]:
    """Poles that the pipeline finds and keeps in a true mask."""
    return _kept(find_instances(mask))


def affine_fit(found: Floats, truth: Floats) -> tuple[float, float]:
    """Scale and offset that bring found inverse depths (n,) to the true ones, least squares."""
    basis = np.column_stack([found, np.ones(len(found))])
    scale, offset = np.linalg.lstsq(basis, truth, rcond=None)[0]
    return float(scale), float(offset)


def correlation(found: Floats, truth: Floats) -> float:
    """Correlation of two sets of values (n,), NaN where one of them does not vary."""
    if len(found) < 3 or np.ptp(found) == 0 or np.ptp(truth) == 0:
        return float("nan")
    return float(np.corrcoef(found, truth)[0, 1])
