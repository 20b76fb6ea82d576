"""What an object is like: how high, whether it leans, has arms, how wide its crown is."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

SHAPE_COLUMNS = (
    "height_m",
    "lean_deg",
    "sigma_lean_deg",
    "lean_azimuth_deg",
    "arm_m",
    "arm_sides",
    "crown_width_m",
)
"""Columns of poles; NaN where the cloud does not tell, and where the kind has no such thing.
Heights by images are not among them: frames and wires cut poles, which were 2 to 5 m too low."""

COLUMN = "column"
"""What the cloud shows of a pole (`cloud_shows`), where it does; of trees see `find_trunks`."""
_SAME_M = 1.0
"""A column of the cloud this near to a pole, and by twice the pole's own error, is the pole."""
_FARTHEST_M = 3.0
"""The same at most: columns may stand so near to each other."""


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
