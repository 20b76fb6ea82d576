"""How likely a found object is real, calibrated on generated roads."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import expit

from roadsight.base.arrays import Floats
from roadsight.poles.images.kinds import KINDS

_ONE_THING = (-0.402, 0.585)
"""Log odds that the rays of a group show one thing, and not strays that meet: so much, and so much
of the evidence. Views of one pole share errors, and of all groups that rays allow the best are
taken, so that the evidence itself says too much. Fitted on 8,243 groups of 210 simulated drives
with up to one stray an image, of which 94 % are real."""
_IS_A_POLE = (-2.07, -1.57, 0.66)
"""Log odds that this thing is a pole: so much, of the logarithm of its error (m), of the logarithm
of one more than its evidence. Trunks and posts that a network takes for poles are real things, seen
less often and less alike. Fitted on 145 groups of one generated road in clouds of 2, 8 and 24
pulses a square metre, with the shipped network's masks; 28 are none. On another road, of 48 groups,
of which 42 are real, the sum of the probabilities is 41.9."""
_TREE = 0.96
"""Of a tree that images show. Of 114 on that road, 110 stand within 3 m of a trunk; of 66 on the
other, 64. How many images show it and how tall it is does not tell them apart."""
_PANEL = 13 / 15
"""Of a panel that is kept: of 13 on two generated roads (seeds 3 and 5), 12 are within 3 m of a
sign; one more of either is counted, for 13 are few. Of the 11 on two others (seeds 1 and 7) all
are. One is wrong, which does not tell by what: its evidence is 7.5, that of signs 7.7 to 47."""
CALIBRATED = "generated roads"
"""What tells a probability, in words: how often what looks so is real on generated roads."""
_DECIDED = "a person's decision"
UNKNOWN = {
    "stem": "none: its evidence is unknown",
    "panel": "none: withheld, of which generated roads have few, or of unknown evidence",
    "crown": "none: no image shows it, or more show something else",
    "line": "none: generated roads have nothing that is taken for a guardrail",
    "block": "none: the cloud's class or planes tell it, and how often they err was not counted",
}
"""Why there is no probability, by the shape of a kind."""


def one_thing_probability(evidence: Floats) -> Floats:
    """Probability (n,) that the rays of a group show one thing, not strays that meet."""
    return np.asarray(expit(_ONE_THING[0] + _ONE_THING[1] * evidence), np.float64)


def real_probability(poles: pd.DataFrame) -> Floats:
    """Probability (n,) that an object is real and of its kind; NaN where nothing tells.

    What a person decided is certain.

    Parameters
    ----------
    poles : kind, evidence (see `triangulate`), sigma_major_m, score (views), kept, decided.
    """
    evidence = poles["evidence"].to_numpy(np.float64)
    sigma_m = poles["sigma_major_m"].to_numpy(np.float64)
    first, by_error, by_evidence = _IS_A_POLE
    with np.errstate(invalid="ignore", divide="ignore"):
        told = by_error * np.log(sigma_m) + by_evidence * np.log1p(np.maximum(evidence, 0.0))
    shape = _shapes(poles)
    found = one_thing_probability(evidence) * expit(first + told)
    found = np.where(shape == "stem", found, np.nan)
    found = np.where((shape == "panel") & poles["kept"] & np.isfinite(evidence), _PANEL, found)
    tree = (poles["kind"] == "tree") & (poles["score"] > 0) & poles["kept"]
    found = np.where(tree, _TREE, found)
    certain = poles["decided"].map({"accepted": 1.0, "moved": 1.0, "rejected": 0.0})
    return np.asarray(certain.fillna(pd.Series(found, index=poles.index)), np.float64)


def probability_source(poles: pd.DataFrame, probability: Floats) -> NDArray[np.object_]:
    """What tells each probability (n,), or why there is none.

    Parameters
    ----------
    poles : kind, decided. probability : as `real_probability` gives it.
    """
    why = np.array([UNKNOWN[shape] for shape in _shapes(poles)], object)
    found = np.where(np.isnan(probability), why, CALIBRATED)
    return np.where(poles["decided"] != "", _DECIDED, found).astype(object)


def _shapes(poles: pd.DataFrame) -> NDArray[np.str_]:
    return np.array([KINDS[kind].shape for kind in poles["kind"]], str)
