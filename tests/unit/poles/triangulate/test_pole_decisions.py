import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.text_tables import COLUMNS, read_decisions, write_decisions
from roadsight.poles.triangulate.site import REACH_M, REJECTED, apply_decisions, nearest_poles

FRAME = Frame((458000.0, 5428000.0, 0.0))


def poles(*places, kind="pole"):
    return pd.DataFrame({
        "id": [f"p{n}" for n in range(len(places))], "kind": kind,
        "x": [float(x) for x, _ in places], "y": [float(y) for _, y in places],
        "kept": [n % 2 == 0 for n in range(len(places))], "reason": "thin",
    })  # fmt: skip


def decisions(*rows):
    return pd.DataFrame(
        [(r[0], "pole", r[1], r[2], *(r[3:5] or (np.nan, np.nan)), "p") for r in rows],
        columns=[*COLUMNS],
    )  # fmt: skip


def test_each_decision_does_what_it_says():
    asked = decisions(("accept", 10, 0), ("reject", 0, 0.5), ("move", 20, 1, 25.0, 3.0))
    table, rows = apply_decisions(poles((0, 0), (10, 0), (20, 0), (30, 0)), asked)
    assert rows.tolist() == [1, 0, 2]
    assert table["decided"].tolist() == ["rejected", "accepted", "moved", ""]
    assert table["kept"].tolist() == [False, True, True, False]
    assert table["reason"].tolist() == [REJECTED, "", "", "thin"]
    assert table[["x", "y"]].iloc[2].tolist() == [25.0, 3.0]


def test_a_decision_finds_its_pole_after_a_run_with_other_errors_and_never_another_kind():
    asked = decisions(("reject", 0, 0), ("reject", 3, 0))
    assert nearest_poles(poles((0.9, 0), (2.2, 0)), asked).tolist() == [0, 1]
    assert nearest_poles(poles((1.6, 0)), asked).tolist() == [-1, 0]
    assert nearest_poles(poles((0, REACH_M + 0.01), kind="pole"), asked).tolist() == [-1, -1]
    assert nearest_poles(poles((0, 0), kind="sign"), asked).tolist() == [-1, -1]
    assert nearest_poles(poles(), asked).tolist() == [-1, -1]


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=8), st.randoms())
def test_no_pole_has_two_decisions(places, random):
    asked = decisions(*(("reject", x + random.random(), y) for x, y in places))
    found = nearest_poles(poles(*places), asked)
    used = found[found >= 0]
    assert len(set(used)) == len(used)


def test_tables_are_written_and_read_alike(tmp_path):
    asked = decisions(("move", 20.5, 1, 25.25, 3.0), ("accept", 10, 0))
    path = tmp_path / "d.csv"
    write_decisions(path, asked, FRAME)
    assert path.read_text().splitlines()[1] == "accept,pole,458010.0,5428000.0,,,p"
    back = read_decisions(path, FRAME)
    assert back["decision"].tolist() == ["accept", "move"]
    assert np.allclose(back[["x", "y", "to_x", "to_y"]].iloc[1].astype(float), [20.5, 1, 25.25, 3])
    write_decisions(tmp_path / "again.csv", back, FRAME)
    assert (tmp_path / "again.csv").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("text", "told"),
    [("decision,kind,x,y,to_x\n", "lacks columns"),
     ("decision,kind,x,y,to_x,to_y\nkeep,pole,1,2,,\n", "is no decision"),
     ("decision,kind,x,y,to_x,to_y\nmove,pole,1,2,,\n", "no finite number"),
     ("decision,kind,x,y,to_x,to_y\naccept,pole,nan,2,,\n", "no finite number")],
)  # fmt: skip
def test_a_wrong_table_is_told(tmp_path, text, told):
    (tmp_path / "d.csv").write_text(text)
    with pytest.raises(InputError, match=told):
        read_decisions(tmp_path / "d.csv", FRAME)
