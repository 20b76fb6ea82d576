import numpy as np
import pandas as pd

from roadsight.poles.triangulate.site import SHAPE_COLUMNS, with_shapes


def poles():
    return pd.DataFrame(
        {
            "kind": ["pole", "pole", "sign", "tree", "pole"],
            "x": [0.0, 10.0, 0.3, 30.0, 40.0],
            "y": np.zeros(5),
            "sigma_major_m": [0.1, 0.5, 0.1, 0.8, 0.1],
            "height_m": [np.nan, np.nan, np.nan, 7.5, np.nan],
            "crown_width_m": [np.nan, np.nan, np.nan, 4.0, np.nan],
        }
    )


def columns():
    return pd.DataFrame(
        {
            "x": [0.2, 11.9, 42.0], "y": np.zeros(3), "top_m": [9.0, 8.0, 7.0],
            "open_top": [0.0, 1.0, 0.0], "lean_deg": [2.0, 3.0, 4.0],
            "sigma_lean_deg": [0.5, 0.5, 0.5], "lean_azimuth_deg": [90.0, 180.0, 270.0],
            "arm_m": [1.2, np.nan, 1.0], "arm_sides": [2.0, 0.0, 1.0],
        }
    )  # fmt: skip


def test_a_pole_has_the_shape_of_the_column_at_its_place():
    found = with_shapes(poles(), columns())
    assert found.loc[0, ["height_m", "lean_deg", "arm_m", "arm_sides"]].tolist() == [9, 2, 1.2, 2]
    # Within twice its own error; how high it is the cloud does not show.
    assert np.isnan(found.loc[1, "height_m"]) and found.loc[1, "lean_deg"] == 3.0
    assert found["cloud_shows"].tolist() == ["column", "column", "", "", ""]


def test_signs_trees_and_poles_away_from_columns_keep_what_they_have():
    found = with_shapes(poles(), columns())
    assert found.loc[[2, 4], list(SHAPE_COLUMNS)].isna().all(axis=None)
    assert found.loc[3, ["height_m", "crown_width_m"]].tolist() == [7.5, 4.0]
    assert np.isnan(found.loc[3, "lean_deg"])


def test_without_columns_nothing_is_known():
    for none in (None, columns()[:0]):
        found = with_shapes(poles().drop(columns=["height_m", "crown_width_m"]), none)
        assert found[list(SHAPE_COLUMNS)].isna().all(axis=None)
    assert set(SHAPE_COLUMNS) <= set(with_shapes(poles()[:0], columns()))
