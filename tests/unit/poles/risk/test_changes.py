import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.__main__ import main
from roadsight.poles.risk.changes import ChangeSettings, changes


def survey(*rows):
    return pd.DataFrame(rows, columns=["id", "kind", "x", "y", "sigma_m"])


def test_same_moved_new_and_gone():
    old = survey(
        ("pole-00000", "pole", 0.0, 0.0, 0.2),
        ("pole-00001", "pole", 40.0, 0.0, 0.2),
        ("pole-00002", "pole", 80.0, 0.0, 0.2),
        ("sign-1", "sign", 120.0, 0.0, np.nan),
    )
    new = survey(
        ("pole-00000", "pole", 40.3, 0.1, 0.2),
        ("pole-00001", "pole", 81.5, 0.0, 0.2),
        ("pole-00002", "pole", 200.0, 0.0, 0.2),
        ("a", "pole", 120.0, 0.0, 0.2),
    )
    found = changes(old, new).set_index("id")
    assert found["status"].to_dict() == {
        "pole-00001": "same", "pole-00002": "moved", "pole-00003": "new", "a": "new",
        "pole-00000": "gone", "sign-1": "gone",
    }  # fmt: skip
    assert found.loc["pole-00001", "new_id"] == "pole-00000"
    assert found.loc["pole-00002", "moved_m"] == pytest.approx(1.5)
    assert found.loc["pole-00002", "limit_m"] == pytest.approx(3.03 * 0.2 * np.sqrt(2))
    assert found.loc["pole-00003", "old_id"] == ""


def test_as_many_pairs_as_can_be_then_the_nearest():
    old = survey(("a", "pole", 0.0, 0.0, 1.0), ("b", "pole", 4.0, 0.0, 1.0))
    new = survey(("c", "pole", 3.9, 0.0, 1.0), ("d", "pole", 8.9, 0.0, 1.0))
    found = changes(old, new, ChangeSettings(reach_m=5.0)).set_index("old_id")
    # The nearest alone (b to c) would leave a and d without a partner.
    assert found.loc["a", "new_id"] == "c"
    assert found.loc["b", "new_id"] == "d"


def test_of_as_many_pairs_the_least_squares_count():
    old = survey(("a", "pole", 0.0, 0.0, 1.0), ("b", "pole", 3.0, 0.0, 1.0))
    new = survey(("c", "pole", 3.0, 0.0, 1.0), ("d", "pole", 4.0, 0.5, 1.0))
    found = changes(old, new, ChangeSettings(reach_m=5.0)).set_index("old_id")
    # The sum of distances alone would be less with b at c and a at d.
    assert found.loc["a", "new_id"] == "c"


@given(st.integers(0, 1000), st.integers(0, 12), st.integers(0, 12))
def test_every_object_is_told_once(seed, many, others):
    rng = np.random.default_rng(seed)

    def made(count, stem):
        rows = [(f"{stem}{n}", "pole", *rng.uniform(0, 20, 2), 0.3) for n in range(count)]
        return survey(*rows)

    old, new = made(many, "p"), made(others, "p")
    found = changes(old, new)
    assert sorted(found["old_id"][found["old_id"] != ""]) == sorted(old["id"])
    assert sorted(found["new_id"][found["new_id"] != ""]) == sorted(new["id"])
    assert found["id"].is_unique
    turned = changes(old.iloc[::-1], new.iloc[::-1])
    paired = ["same", "moved"]
    assert turned["status"].isin(paired).sum() == found["status"].isin(paired).sum()


def written(path, text):
    path.write_text(text)
    return str(path)


def test_the_verb_compares_degrees_whatever_the_grid(tmp_path, capsys):
    old = written(
        tmp_path / "old.csv",
        "id,kind,x,y,latitude,longitude,sigma_major_m\np-1,pole,1,1,35.0,-83.0,0.1\n"
        "p-2,pole,1,1,35.001,-83.0,0.1\n",
    )
    new = written(
        tmp_path / "new.csv",
        "id,kind,x,y,latitude,longitude,sigma_major_m\np-1,pole,9,9,35.00002,-83.0,0.1\n",
    )
    out = str(tmp_path / "changes.csv")
    assert main(["changes", old, new, "-o", out]) == 0
    assert "0 same, 1 moved, 0 new, 1 gone" in capsys.readouterr().out
    table = pd.read_csv(out)
    assert table["moved_m"].iloc[0] == pytest.approx(2.219, abs=0.01)
    assert table["latitude"].tolist() == pytest.approx([35.00002, 35.001])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,name\na,b\n", "lacks columns"),
        ("id,x,y\na,1,2\na,3,4\n", "two objects share an id"),
        ("id,x,y\na,1,\n", "has no place"),
        ("lat,lon\n1,2\n", "one survey has latitude"),
    ],
)
def test_bad_surveys_are_refused(tmp_path, capsys, text, message):
    old = written(tmp_path / "old.csv", "id,x,y\na,0,0\n")
    new = written(tmp_path / "new.csv", text)
    assert main(["changes", old, new, "-o", str(tmp_path / "out.csv")]) == 2
    assert message in capsys.readouterr().err
    assert main(["changes", old, old, "-o", str(tmp_path / "o.csv"), "--reach-m", "-1"]) == 2
