"""A sample of found poles that people check, and what it says of all (paper 2, section 4.2).

What was not checked counts neither for nor against: a pole that nobody looked at is no false one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import norm

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.poles.risk.validation import THRESHOLDS_M, describe

# Verdicts: a pole stands at the place given; none is near; a pole that the survey lacks.
POLE, NONE, MISSED = "pole", "none", "missed"
FEWEST = 20  # checked places that the national standard for spatial data accuracy asks for
# Values of a column at most that are strata of their own; numbers with more are cut in thirds.
LARGEST_STRATA = 10
_UNKNOWN = "unknown"
_THIRDS = ("lowest third", "middle third", "highest third")
_Z95 = 1.959963984540054  # of a normal distribution, 95 % lie within so many standard deviations
# Radius that holds 95 % of a normal error, over its root mean square distance where both axes are
# alike, over that of an axis where they are not, and the least ratio of axes for which it holds
# (FGDC-STD-007.3, appendix 3-A).
_ROUND, _OVAL, _LEAST_RATIO = 1.7308, 2.4477, 0.6
# Places along an axis at which a distribution is summed, and how far out.
_NODES, _FAR_SIGMAS = 4001, 6.0


def strata(values: pd.Series) -> pd.Series:
    """Name of the stratum of each row: its value, or the third in which a number lies.

    Raises
    ------
    InputError : more than 10 values that are not all numbers.
    """
    texts = values.astype(object).fillna("").astype(str).replace("", _UNKNOWN)
    if texts.nunique() <= LARGEST_STRATA:
        return texts
    given = texts != _UNKNOWN
    numbers = pd.to_numeric(texts.where(given), errors="coerce")
    if numbers[given].isna().any():
        raise InputError(
            "has too many values for strata",
            where=f"column {values.name}",
            found=texts.nunique(),
            allowed=f"at most {LARGEST_STRATA} values, or numbers, which are cut in thirds",
        )
    edges = [0.0, 1 / 3, 2 / 3, 1.0]
    third = pd.cut(numbers.rank(method="first", pct=True), edges, labels=list(_THIRDS))
    return third.astype(object).where(given, _UNKNOWN)


def draw(names: pd.Series, count: int, rng: np.random.Generator) -> Ints:
    """Rows drawn at random, as many of each stratum as it is of all, but two at least.

    Parameters
    ----------
    names : stratum of each row.
    """
    sizes = names.value_counts().sort_index()
    count = min(count, len(names))
    exact = sizes * count / len(names)
    shares = exact.astype(int).clip(lower=2).clip(upper=sizes)
    for name in (exact - shares).sort_values(ascending=False, kind="stable").index:
        if shares.sum() >= count:
            break
        shares[name] += shares[name] < sizes[name]
    rows = [
        rng.choice(np.flatnonzero(names == name), share, replace=False)
        for name, share in shares.items()
    ]
    return np.sort(np.concatenate(rows)) if rows else np.empty(0, np.int64)


def score_checks(
    error_m: Floats, missed: int, stratum: Sequence[str], sizes: dict[str, int]
) -> dict[str, Any]:
    """What the checked ones say of all.

    Parameters
    ----------
    error_m : (n, 2) found less true place of each checked pole, NaN where none stands.
    missed : poles that the survey lacks beside the checked ones: nearer to one of them than to any
        other found pole. stratum : of each checked pole. sizes : poles of each stratum, checked or
        not.

    Returns
    -------
    thresholds : as `score_thresholds`, of the checked poles, with precision_all, that of all poles
        by the strata's sizes, and its 95 % interval (Wilson, of as many independent checks as the
        unequal weights and the poles that are left leave); None where a stratum has no check.
    unchecked_strata : their names. distance_m : statistics. nssda_m : 95 % of the places are within
        it (None below 20 checks with a pole), by the errors along their own axes. rmse_x_m,
        rmse_y_m.
    """
    distance_m = np.hypot(*error_m.reshape(-1, 2).T)
    stands = np.isfinite(distance_m)
    checked = pd.Series(list(stratum)).value_counts()
    lacking = sorted(set(sizes) - set(checked.index))
    weight = np.array([sizes[name] / checked[name] for name in stratum], np.float64)
    rows = []
    for threshold_m in THRESHOLDS_M:
        right = stands & (distance_m <= threshold_m)
        tp, fn = int(right.sum()), int((stands & ~right).sum()) + missed
        share = None
        if len(weight) and not lacking:
            share = float((weight * right).sum() / weight.sum())
        rows.append(
            {
                "threshold_m": threshold_m,
                "tp": tp,
                "fp": len(right) - tp,
                "fn": fn,
                "precision": tp / len(right) if len(right) else None,
                "recall": tp / (tp + fn) if tp + fn else None,
                "f1": 2 * tp / (len(right) + tp + fn) if len(right) + tp + fn else None,
                "precision_all": share,
                "precision_all_95": None if share is None else wilson(share, weight),
            }
        )
    return {
        "checked": len(error_m),
        "missed": missed,
        "unchecked_strata": lacking,
        "thresholds": rows,
        "distance_m": describe(distance_m),
    } | _nssda(error_m[stands])


def _nssda(error_m: Floats) -> dict[str, Any]:
    """Horizontal accuracy by the national standard for spatial data accuracy."""
    if not len(error_m):
        return {"nssda_m": None, "rmse_x_m": None, "rmse_y_m": None}
    rmse = np.sqrt((error_m**2).mean(axis=0))
    # Along the errors' own axes: a road may run any way on the grid.
    squares = np.linalg.eigvalsh(error_m.T @ error_m / len(error_m))
    less, more = np.sqrt(np.maximum(squares, 0.0))
    return {
        "nssda_m": radius_95_m(less, more) if len(error_m) >= FEWEST else None,
        "rmse_x_m": float(rmse[0]),
        "rmse_y_m": float(rmse[1]),
    }


def wilson(share: float, weight: Floats) -> tuple[float, float]:
    """Interval that holds a share in 95 of 100 samples (Wilson 1927; weights by Kish 1965).

    Parameters
    ----------
    weight : (n,) of how many each one stands for. Where each is its own, nothing is left to chance.
    """
    total = float(weight.sum())
    n = total**2 / float((weight**2).sum())
    left = 1 - min(len(weight) / total, 1)
    if left <= 0:
        return share, share
    n /= left
    middle = (share + _Z95**2 / (2 * n)) / (1 + _Z95**2 / n)
    half = np.sqrt(share * (1 - share) / n + _Z95**2 / (4 * n**2)) * _Z95 / (1 + _Z95**2 / n)
    return max(float(middle - half), 0.0), min(float(middle + half), 1.0)


def radius_95_m(x_m: float, y_m: float) -> float:
    """Radius that holds 95 % of a normal error with these root mean squares on its axes.

    Where the lesser is at least 0.6 of the greater, by the formulas of FGDC-STD-007.3, appendix
    3-A; it has none for longer ellipses, of which the distribution is integrated.
    """
    less, more = sorted((float(x_m), float(y_m)))
    if np.isclose(less, more, rtol=1e-6):
        return _ROUND * float(np.hypot(less, more))
    if less >= _LEAST_RATIO * more:
        return _OVAL * 0.5 * (less + more)
    # Of each place along the longer axis, the share of the shorter one that stays within.
    along = more * np.linspace(-_FAR_SIGMAS, _FAR_SIGMAS, _NODES)
    density = norm.pdf(along / more)
    density /= density.sum()

    def missing(radius: float) -> float:
        half = np.sqrt(np.maximum(radius**2 - along**2, 0.0))
        inside = 2 * norm.cdf(half / max(less, 1e-12 * more)) - 1
        return float((density * inside).sum()) - 0.95

    return float(brentq(missing, 0.0, _FAR_SIGMAS * more))
