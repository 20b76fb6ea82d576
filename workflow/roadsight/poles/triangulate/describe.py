"""What an object is like, and how likely it is real.

Height, lean, arms and crown are the cloud's; probabilities are calibrated on generated roads.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import expit, logit

from roadsight.base.arrays import Floats
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.trees import CROWN, NO_TRUNK, TRUNK

# Columns of poles; NaN where the cloud does not tell, and where the kind has no such thing. Heights
# by images are not among them: frames and wires cut poles, which were 2 to 5 m too low.
SHAPE_COLUMNS = (
    "height_m",
    "lean_deg",
    "sigma_lean_deg",
    "lean_azimuth_deg",
    "arm_m",
    "arm_sides",
    "crown_width_m",
)
# What the cloud shows of a pole (`cloud_shows`), where it does; of trees see `find_trunks`.
COLUMN = "column"
# A column of the cloud this near to a pole, and by twice the pole's own error, is the pole.
_SAME_M = 1.0
_FARTHEST_M = 3.0  # the same at most: columns may stand so near to each other


def with_shapes(poles: pd.DataFrame, columns: pd.DataFrame | None) -> pd.DataFrame:
    """Poles with `SHAPE_COLUMNS` and `cloud_shows`, from the cloud's columns at their places.

    Parameters
    ----------
    poles : kind, x, y, sigma_major_m, and what objects of the cloud have already, such as
        `cloud_shows` of trees.
    columns : x, y, top_m, open_top (1 where the cloud does not show how high it is) and shapes of
        the columns of the cloud, see `stem_shapes`; None where no one looked for them.
    """
    nothing = pd.Series(np.nan, index=poles.index)
    poles = poles.assign(**{name: poles.get(name, nothing) for name in SHAPE_COLUMNS})
    shows = poles.get("cloud_shows", pd.Series("", index=poles.index))
    poles["cloud_shows"] = shows.astype(object).fillna("").astype(str)
    rows = np.flatnonzero(poles["kind"] == "pole")
    if columns is None or columns.empty or not len(rows):
        return poles
    own = poles.iloc[rows]
    away, nearest = cKDTree(columns[["x", "y"]].to_numpy(np.float64)).query(
        own[["x", "y"]].to_numpy(np.float64)
    )
    limit = np.minimum(_SAME_M + 2.0 * own["sigma_major_m"].to_numpy(np.float64), _FARTHEST_M)
    same = away <= limit
    found = columns.iloc[nearest[same]].set_index(poles.index[rows[same]])
    found = found.assign(height_m=found["top_m"].where(found["open_top"] == 0))
    names = [name for name in SHAPE_COLUMNS if name != "crown_width_m"]
    poles.loc[found.index, names] = found[names]
    poles.loc[found.index, "cloud_shows"] = COLUMN
    return poles


# Log odds that the rays of a group show one thing, and not strays that meet: so much, and so much
# of the evidence. Views of one pole share errors, and of all groups that rays allow the best are
# taken, so that the evidence itself says too much. Fitted on 8,243 groups of 210 simulated drives
# with up to one stray an image, of which 94 % are real.
_ONE_THING = (-0.402, 0.585)
# Log odds that this thing is a pole: so much, of the logarithm of its error (m), of the logarithm
# of one more than its evidence. Trunks and posts that a network takes for poles are real things,
# seen less often and less alike. Fitted on 109 groups of one generated road (seed 1) in clouds of
# 2, 8 and 24 pulses a square metre, with the shipped network's masks; 20 are none. On three other
# roads (seeds 3, 5, 7) in such clouds, of 194 groups, of which 167 are real, the sum of the
# probabilities is 157.9.
_IS_A_POLE = (-5.64, -0.72, 2.34)
# Of a tree that images show. Of 270 on that road in these clouds, 266 stand within 3 m of a trunk;
# of 677 on the others, 671. How many images show it and how tall it is does not tell them apart.
_TREE = 0.98
# Times its odds where the cloud shows a trunk, or that there is none: shares of 56 trunks that
# people labelled in five real streets (no one of them contradicted, which counts as 1 of 58), over
# those of 277 places there without one. A crown alone has the odds times the share of the trees
# that have no more: the more trunks a cloud shows, the more does one tell that is not there.
_SHOWN = {TRUNK: 24 / 56 * 277 / 8, NO_TRUNK: 1 / 58 * 277 / 95}
# Of a panel that is kept: of 38 on two generated roads (seeds 3 and 5) in three clouds, 36 are
# within 3 m of a sign; one more of either is counted, for 38 are few. Of the 43 on two others
# (seeds 1 and 7) 41 are. What is wrong has evidence of 10.1 to 14.6, signs of 10.4 and more.
_PANEL = 37 / 40
# What tells a probability, in words: how often what looks so is real on generated roads.
CALIBRATED = "generated roads"
_DECIDED = "a person's decision"
# Why there is no probability, by the shape of a kind.
UNKNOWN = {
    "stem": "none: its evidence is unknown",
    "panel": "none: withheld, of which generated roads have few, or of unknown evidence",
    "crown": "none: no image shows it, or more show something else",
    "line": "none: generated roads have nothing that is taken for a guardrail",
    "block": "none: the cloud's class or planes tell it, and how often they err was not counted",
}


def real_probability(poles: pd.DataFrame) -> Floats:
    """Probability (n,) that an object is real and of its kind; NaN where nothing tells.

    What a person decided is certain.

    Parameters
    ----------
    poles : kind, evidence (see `triangulate`), sigma_major_m, score (views), kept, decided,
    cloud_shows (of trees, see `find_trunks`).
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
    shows = poles["cloud_shows"].where(tree, "")
    count = shows.value_counts()
    # Nothing is known of a cloud before its first tree.
    trunks = count.get(TRUNK, 0) / (count.get(TRUNK, 0) + count.get(CROWN, 0) + 1)
    times = shows.map({**_SHOWN, CROWN: 1.0 - trunks}).fillna(1.0).to_numpy(np.float64)
    found = np.where(tree, expit(logit(_TREE) + np.log(times)), found)
    certain = poles["decided"].map({"accepted": 1.0, "moved": 1.0, "rejected": 0.0})
    return np.asarray(certain.fillna(pd.Series(found, index=poles.index)), np.float64)


def one_thing_probability(evidence: Floats) -> Floats:
    """Probability (n,) that the rays of a group show one thing, not strays that meet."""
    return np.asarray(expit(_ONE_THING[0] + _ONE_THING[1] * evidence), np.float64)


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
