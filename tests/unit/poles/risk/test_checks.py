import json

import numpy as np
import pandas as pd
import pytest

from roadsight.__main__ import main
from roadsight.base.errors import InputError
from roadsight.poles.risk.checks import draw, radius_95_m, score_checks, strata, wilson


def test_numbers_are_cut_in_thirds_and_values_stay():
    assert strata(pd.Series(["a", "", "b", "a"])).tolist() == ["a", "unknown", "b", "a"]
    found = strata(pd.Series(np.r_[np.arange(30.0), np.nan]))
    assert found[:10].nunique() == 1
    assert found.value_counts().to_dict() == {
        "lowest third": 10,
        "middle third": 10,
        "highest third": 10,
        "unknown": 1,
    }


@pytest.mark.parametrize("count", [1, 10, 29, 300])
def test_each_stratum_is_drawn_by_its_size(rng, count):
    names = pd.Series(rng.permutation(["a"] * 60 + ["b"] * 36 + ["c"] * 3 + ["d"]))
    rows = draw(names, count, rng)
    assert len(set(rows.tolist())) == len(rows)
    found = names[rows].value_counts()
    assert found["c"] >= 2
    assert found["d"] == 1
    if 10 <= count < 100:
        assert count <= len(rows) <= count + 2
        assert found["a"] == pytest.approx(0.6 * count, abs=2)
    if count == 300:
        assert len(rows) == 100


def test_all_are_as_likely_to_be_drawn(rng):
    names = pd.Series(["a"] * 12 + ["b"] * 6)
    times = np.zeros(18)
    for _ in range(3000):
        times[draw(names, 6, rng)] += 1
    assert times == pytest.approx(1000, rel=0.12)


def test_the_study_s_table_2():
    """10 of 29 checked poles within 3 m, of 28 that stand; 16 within 5 m (paper 2, table 2)."""
    distance = np.r_[np.full(10, 2.0), np.full(6, 4.0), np.full(11, 12.0), np.nan, np.nan]
    error = np.column_stack([distance, np.zeros(29)])
    found = score_checks(error, 1, ["all"] * 29, {"all": 200})
    rows = {row["threshold_m"]: row for row in found["thresholds"]}
    assert [rows[3][name] for name in ("tp", "fp", "fn")] == [10, 19, 18]
    assert [rows[5][name] for name in ("tp", "fp", "fn")] == [16, 13, 12]
    assert [round(rows[3][name], 2) for name in ("precision", "recall", "f1")] == [0.34, 0.36, 0.35]
    assert [round(rows[5][name], 2) for name in ("precision", "recall", "f1")] == [0.55, 0.57, 0.56]
    assert rows[3]["precision_all"] == pytest.approx(10 / 29)


def test_strata_count_by_their_size():
    """Two of two right in 90, none of two right in 10: nine tenths are right, not a half."""
    error = np.array([[0.5, 0], [0.5, 0], [np.nan, np.nan], [np.nan, np.nan]])
    found = score_checks(error, 0, ["a", "a", "b", "b"], {"a": 90, "b": 10})
    assert found["thresholds"][0]["precision"] == 0.5
    assert found["thresholds"][0]["precision_all"] == pytest.approx(0.9)
    low, high = found["thresholds"][0]["precision_all_95"]
    assert low < 0.5
    assert high > 0.95


def test_intervals_hold_the_truth(rng):
    held = 0
    for _ in range(2000):
        low, high = wilson(rng.binomial(30, 0.8) / 30, np.full(30, 100.0))
        held += low <= 0.8 <= high
    assert held / 2000 == pytest.approx(0.95, abs=0.025)


@pytest.mark.parametrize("ratio", [1.0, 0.8, 0.5, 0.2, 0.01, 0.0])
def test_the_radius_holds_95_of_100_whatever_the_ellipse(rng, ratio):
    error = rng.normal(0, 1.0, (400_000, 2)) * (3.0 * ratio, 3.0)
    inside = np.hypot(*error.T) <= radius_95_m(3.0 * ratio, 3.0)
    assert inside.mean() == pytest.approx(0.95, abs=0.01 if ratio >= 0.6 else 0.002)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 45.0])
def test_accuracy_does_not_hang_on_how_a_road_runs(rng, turn_deg):
    """Errors along a road of any direction: half a metre across, three along it."""
    along = np.radians(turn_deg)
    axes = np.array([[np.cos(along), np.sin(along)], [-np.sin(along), np.cos(along)]])
    error = rng.normal(0, 1.0, (50_000, 2)) * (3.0, 0.5) @ axes
    found = score_checks(error, 0, ["all"] * len(error), {"all": len(error)})
    inside = np.hypot(*error.T) <= found["nssda_m"]
    assert inside.mean() == pytest.approx(0.95, abs=0.005)


def test_nothing_is_left_to_chance_where_all_were_checked():
    assert wilson(0.7, np.ones(30)) == (0.7, 0.7)
    narrow, wide = (np.ptp(wilson(0.7, np.full(30, w))) for w in (1.2, 100.0))
    assert narrow < 0.5 * wide


def test_of_strata_that_nobody_checked_nothing_is_said():
    error = np.zeros((4, 2))
    found = score_checks(error, 0, ["good"] * 4, {"good": 50, "bad": 50})
    assert found["unchecked_strata"] == ["bad"]
    assert found["thresholds"][0]["precision"] == 1.0
    assert found["thresholds"][0]["precision_all"] is None
    assert found["thresholds"][0]["precision_all_95"] is None


def test_texts_of_many_values_are_no_strata():
    with pytest.raises(InputError, match="too many values"):
        strata(pd.Series([*[f"r{n}" for n in range(20)], "40"], name="routes"))


def test_the_standard_holds_95_of_100_places(rng):
    error = rng.normal(0, 1.5, (4000, 2))
    found = score_checks(error, 0, ["all"] * 4000, {"all": 4000})
    inside = np.hypot(*error.T) <= found["nssda_m"]
    assert inside.mean() == pytest.approx(0.95, abs=0.01)
    assert score_checks(error[:19], 0, ["all"] * 19, {"all": 99})["nssda_m"] is None


@pytest.fixture
def poles(tmp_path, rng):
    table = pd.DataFrame(
        {
            "id": [f"pole-{n}" for n in range(60)],
            "latitude": 35.3 + rng.uniform(0, 0.01, 60),
            "longitude": -83.1 + rng.uniform(0, 0.01, 60),
            "sigma_major_m": rng.uniform(0.1, 2, 60),
        }
    )
    table.to_csv(tmp_path / "poles.csv", index=False)
    return tmp_path / "poles.csv"


def test_a_sheet_is_drawn_filled_in_and_scored(poles, tmp_path, capsys):
    sheet, out = tmp_path / "sheet.csv", tmp_path / "score.json"
    assert main(["draw", str(poles), "--count", "24", "-o", str(sheet)]) == 0
    first = sheet.read_bytes()
    assert main(["draw", str(poles), "--count", "24", "-o", str(sheet)]) == 0
    assert sheet.read_bytes() == first
    table = pd.read_csv(sheet, dtype={"verdict": str, "note": str})
    assert len(table) == 24
    table["verdict"] = ["pole"] * 22 + ["none", None]
    north_m = np.r_[np.full(20, 1.0), 4.0, 30.0, np.nan, np.nan]
    table["latitude"] = table["found_latitude"] + north_m / 110_950  # m a degree at 35.3 degrees
    table["longitude"] = table["found_longitude"]
    own = {"verdict": "missed", "latitude": 35.3, "longitude": -83.1}
    pd.concat([table, pd.DataFrame([own])]).to_csv(sheet, index=False)
    assert main(["score", str(sheet), "-o", str(out)]) == 0
    content = json.loads(out.read_text())
    assert [content[name] for name in ("checked", "missed", "unchecked")] == [23, 1, 1]
    row = next(row for row in content["thresholds"] if row["threshold_m"] == 3)
    assert [row[name] for name in ("tp", "fp", "fn")] == [20, 3, 3]
    assert content["distance_m"]["median"] == pytest.approx(1.0, abs=0.005)
    assert content["rmse_x_m"] < 0.001
    assert "95 % of the poles are within" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("verdict", "maybe", "unknown verdict"),
        ("verdict", "pole", "lacks a place"),
        ("verdict", "", "holds no verdict"),
        ("stratum_size", "0", "size of its stratum"),
        ("found_latitude", "north", "lacks a place"),
        ("found_latitude", "353.0", "no place on Earth"),
        ("stratum", "", "no stratum"),
        ("stratum_size", "900", "two sizes of one stratum"),
        ("id", "pole-0", "a pole twice"),
    ],
)
def test_sheets_that_are_wrong_are_refused(poles, tmp_path, capsys, column, value, told):
    sheet, out = tmp_path / "sheet.csv", tmp_path / "score.json"
    main(["draw", str(poles), "-o", str(sheet)])
    table = pd.read_csv(sheet, dtype=str)
    if column != "verdict":
        table["verdict"] = "none"
    table[column] = table[column].astype(object)
    table.loc[3, column] = value
    if column == "id":
        table.loc[5, column] = value
    table.to_csv(sheet, index=False)
    assert main(["score", str(sheet), "-o", str(out)]) == 2
    assert told in capsys.readouterr().err
    assert not out.exists()


def test_a_sheet_with_verdicts_is_not_written_over(poles, tmp_path, capsys):
    sheet = tmp_path / "sheet.csv"
    main(["draw", str(poles), "-o", str(sheet)])
    table = pd.read_csv(sheet, dtype=str)
    table["verdict"] = ["none", *[""] * (len(table) - 1)]
    table.to_csv(sheet, index=False)
    before = sheet.read_bytes()
    assert main(["draw", str(poles), "-o", str(sheet)]) == 2
    assert "holds verdicts" in capsys.readouterr().err
    assert sheet.read_bytes() == before


def test_a_site_without_a_place_on_earth_is_checked_in_its_metres(poles, tmp_path):
    table = pd.read_csv(poles)
    x = np.arange(60.0)
    table.assign(latitude="", longitude="", x=x, y=2 * x).to_csv(poles, index=False)
    sheet, out = tmp_path / "sheet.csv", tmp_path / "score.json"
    assert main(["draw", str(poles), "-o", str(sheet)]) == 0
    sheet_table = pd.read_csv(sheet, dtype={"verdict": str})
    sheet_table = sheet_table.assign(
        verdict="POLE ", x=sheet_table["found_x"] + 3, y=sheet_table["found_y"] - 4
    )
    sheet_table.to_csv(sheet, index=False)
    assert main(["score", str(sheet), "-o", str(out)]) == 0
    assert json.loads(out.read_text())["distance_m"]["mean"] == pytest.approx(5.0)


@pytest.mark.parametrize("given", [["--by", "colour"], ["--count", "0"], ["--seed", "-1"]])
def test_draws_of_nothing_are_refused(poles, tmp_path, capsys, given):
    assert main(["draw", str(poles), *given, "-o", str(tmp_path / "sheet.csv")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
