"""Found poles against known ones: matches, errors, precision and recall (paper 2, chapter 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely
from pyproj import Geod
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints

# Distances up to which a found pole counts as right, each scored by itself.
THRESHOLDS_M = tuple(range(1, 17))
FEWEST_TRUTHS = 5  # with fewer known poles the figures come with a warning
OTHERS_M = 3.0  # distance up to which a found sign or tree counts as right
LINES_M = 1.0  # the same of a guardrail
# Trees count this near to the road's edge: clear zones end there, and forests begin.
NEAR_EDGE_M = 10.0
# Edge points within this tell the edge's direction: fewer are noise, more follow a bend.
_EDGE_REACH_M = 5.0
_GEOD = Geod(ellps="WGS84")


def match_points(found_m: Floats, truth_m: Floats, threshold_m: float, power: int = 1) -> Ints:
    """One-to-one matches within a distance: as many as can be, of the least sum of distances.

    Parameters
    ----------
    found_m, truth_m : shapes (n, 2) and (m, 2), metres. power : of the distances in that sum.

    Returns
    -------
    rows of found and of truth, shape (k, 2), by found
    """
    none = np.empty((0, 2), np.int64)
    if len(found_m) == 0 or len(truth_m) == 0:
        return none
    near = cKDTree(found_m).sparse_distance_matrix(
        cKDTree(truth_m), threshold_m, output_type="ndarray"
    )
    if len(near) == 0:
        return none
    n, size = len(found_m), len(found_m) + len(truth_m)
    graph = csr_array((np.ones(len(near)), (near["i"], n + near["j"])), shape=(size, size))
    _, part = connected_components(graph, directed=False)
    order = np.lexsort([near["j"], near["i"], part[near["i"]]])
    near = near[order]
    cuts = np.flatnonzero(np.diff(part[near["i"]])) + 1
    found = []
    for block in np.split(near, cuts):
        rows, row = np.unique(block["i"], return_inverse=True)
        columns, column = np.unique(block["j"], return_inverse=True)
        # A missing match costs more than all distances of the part together.
        missing = (threshold_m**power + 1.0) * (min(len(rows), len(columns)) + 1)
        cost = np.full((len(rows), len(columns)), missing)
        cost[row, column] = block["v"] ** power
        i, j = linear_sum_assignment(cost)
        real = cost[i, j] < missing
        found.append(np.column_stack([rows[i[real]], columns[j[real]]]))
    matches = np.concatenate(found)
    return matches[np.argsort(matches[:, 0])]


def score_thresholds(
    found_m: Floats, truth_m: Floats, thresholds_m: tuple[float, ...] = THRESHOLDS_M
) -> list[dict[str, float | int | None]]:
    """True and false positives, false negatives, precision, recall and F1 at each threshold.

    A ratio with nothing below the line is None.
    """
    rows: list[dict[str, float | int | None]] = []
    for threshold_m in thresholds_m:
        tp = len(match_points(found_m, truth_m, threshold_m))
        scores = _scores(tp, len(found_m) - tp, len(truth_m) - tp)
        rows.append({"threshold_m": threshold_m, **scores})
    return rows


def score_near(
    found_m: Floats, truth_m: Floats, found_counts: Bools, truth_counts: Bools
) -> dict[str, float | int | None]:
    """Scores of objects of which only those near something count.

    An object beyond that limit may be the partner of one within it, so that an error of a place
    across the limit is not two.

    Parameters
    ----------
    found_counts, truth_counts : (n,) and (m,) whether each counts.
    """
    matches = match_points(found_m, truth_m, OTHERS_M)
    tp = int(truth_counts[matches[:, 1]].sum())
    alone = np.ones(len(found_m), bool)
    alone[matches[:, 0]] = False
    fp, fn = int((alone & found_counts).sum()), int(truth_counts.sum()) - tp
    return {"threshold_m": OTHERS_M, **_scores(tp, fp, fn)}


def score_lines(found: Sequence[Floats], truth: Sequence[Floats]) -> dict[str, float | int | None]:
    """Scores by length, m: a line is right where one of the others runs within a distance.

    Parameters
    ----------
    found, truth : lines, each (n, 2).
    """
    ours, theirs = (
        shapely.union_all([shapely.LineString(one) for one in o]) for o in (found, truth)
    )
    tp = theirs.intersection(ours.buffer(LINES_M)).length
    fp = ours.difference(theirs.buffer(LINES_M)).length
    return {"threshold_m": LINES_M, **_scores(tp, fp, theirs.length - tp)}


def _scores(tp: float, fp: float, fn: float) -> dict[str, float | int | None]:
    return {
        "tp": tp,
        "fp": fp,
        "fn": fn,
        "precision": _ratio(tp, tp + fp),
        "recall": _ratio(tp, tp + fn),
        "f1": _ratio(2 * tp, 2 * tp + fp + fn),
    }


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def describe(values: Floats) -> dict[str, float | int | None]:
    """Count, mean, standard deviation, least, quartiles and greatest; None where empty."""
    values = values[np.isfinite(values)]
    names = ("mean", "std", "min", "q25", "median", "q75", "max")
    if len(values) == 0:
        return {"count": 0} | dict.fromkeys(names)
    spread = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    numbers = [float(values.mean()), spread, *np.quantile(values, [0, 0.25, 0.5, 0.75, 1])]
    return {"count": len(values)} | {
        name: float(number) for name, number in zip(names, numbers, strict=True)
    }


def describe_scenarios(errors_m: Floats, scenarios: pd.DataFrame) -> dict[str, Any]:
    """Errors of the matches by scenario; None for a class that could not be measured.

    Parameters
    ----------
    errors_m : shape (n,). scenarios : the same rows, see `roadsight.poles.risk.scenarios`.
    """
    found: dict[str, Any] = {}
    for name in ("straight", "curved", "intersection", "extraneous"):
        known = scenarios[name].notna().to_numpy() if len(scenarios) else np.zeros(0, bool)
        if len(scenarios) and not known.any():
            found[name] = None
            continue
        chosen = known & scenarios[name].eq(True).to_numpy()
        found[name] = describe(errors_m[chosen])
    return found


def cautions(truths: int, out_of_reach: int) -> list[str]:
    """What a reader of the figures should know."""
    found = []
    if truths < FEWEST_TRUTHS:
        found.append(f"only {truths} known poles within reach: the figures say little")
    if out_of_reach:
        found.append(
            f"{out_of_reach} known poles lie out of reach of every camera and do not count"
        )
    return found


def within_reach(places_m: Floats, cameras_m: Floats, reach_m: float) -> Bools:
    """Whether a camera stands within reach of each place."""
    if len(places_m) == 0 or len(cameras_m) == 0:
        return np.zeros(len(places_m), bool)
    distance, _ = cKDTree(cameras_m).query(places_m)
    return np.asarray(distance <= reach_m)


def geodesic_m(
    latitude_deg: Floats, longitude_deg: Floats, to_latitude: Floats, to_longitude: Floats
) -> Floats:
    """Distances on the WGS 84 ellipsoid."""
    _, _, distance = _GEOD.inv(longitude_deg, latitude_deg, to_longitude, to_latitude)
    return np.asarray(distance, np.float64)


@dataclass(frozen=True)
class RoadEdges:
    """Edge points of the road (n, 2), local metres."""

    xy_m: Floats

    def offset_m(self, places_m: Floats) -> tuple[Floats, Ints]:
        """Distance to the nearest edge point and its row."""
        distance, row = cKDTree(self.xy_m).query(places_m)
        return np.asarray(distance), np.asarray(row, np.int64)

    def normals(self, places_m: Floats) -> Floats:
        """Unit vectors (n, 2) across the edge nearest to each place.

        The edge's direction is the main axis of its points within 5 m; where they have none, the
        way from the place to the edge is taken.
        """
        tree = cKDTree(self.xy_m)
        distance, row = tree.query(places_m)
        normals = np.empty((len(places_m), 2))
        for number, near in enumerate(tree.query_ball_point(self.xy_m[row], _EDGE_REACH_M)):
            points = self.xy_m[sorted(near)]
            variances, axes = np.linalg.eigh(np.cov(points.T, bias=True).reshape(2, 2))
            away = places_m[number] - self.xy_m[row[number]]
            if len(points) >= 3 and variances[1] > 4 * variances[0]:
                normals[number] = axes[:, 0]
            elif distance[number] > 0:
                normals[number] = away / distance[number]
            else:
                normals[number] = np.nan
        return normals


def split_errors(errors_m: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Sizes of error vectors (n, 2) across and along the road edge."""
    across = np.abs((errors_m * normals).sum(axis=1))
    along = np.abs(errors_m[:, 0] * normals[:, 1] - errors_m[:, 1] * normals[:, 0])
    return across, along
