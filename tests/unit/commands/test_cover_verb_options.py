"""Options of the verb `roadsight cover` on a matrix whose answers are plain to see."""

import json

import numpy as np
import pytest
from scipy import sparse

from roadsight.__main__ import main

# Rows 0 and 1 see the left, 2 and 3 the right, 4 a little of both.
SEEN = [[1, 1, 1, 0, 0, 0], [1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1], [0, 0, 0, 1, 1, 0],
        [0, 0, 1, 1, 0, 0]]  # fmt: skip


@pytest.fixture
def cover(tmp_path):
    matrix = tmp_path / "m.npz"
    sparse.save_npz(matrix, sparse.csr_matrix(np.array(SEEN)))

    def run(*options, **arrays):
        for name, values in arrays.items():
            np.save(tmp_path / f"{name}.npy", values)
            options += (f"--{name}", str(tmp_path / f"{name}.npy"))
        code = main(["cover", str(matrix), *options, "-o", str(tmp_path / "s.json")])
        return json.loads((tmp_path / "s.json").read_text()) if code == 0 else code

    return run


def test_weights_decide_what_a_budget_sees(cover, capsys):
    found = cover("--budget", "1", weights=[1.0, 1, 1, 5, 1, 1])
    assert found["chosen"] == [2]
    assert (found["objective"], found["bound"], found["cost"]) == (7, 7, 1)
    assert "7 of 10 weight covered" in capsys.readouterr().out


def test_a_price_weighs_targets_against_rows(cover):
    assert cover("--price", "0.3")["chosen"] == []
    found = cover("--price", "0.4")
    assert (found["objective"], found["covered"], len(found["chosen"])) == (2.0, 6.0, 2)


def test_needs_of_single_targets(cover):
    found = cover(needs=[2, 1, 1, 0, 0, 0])
    assert found["chosen"] == [0, 1]
    assert found["status"] == "optimal"


def test_rows_that_must_and_must_not_be_chosen(cover):
    found = cover(mandatory=[4], forbidden=[0])
    assert found["chosen"] == [1, 2, 4]


def test_rows_stand_apart(cover):
    places = np.array([[0.0, 0], [9, 0], [1, 0], [8, 0], [20, 0]])
    assert cover("--spacing", "5", positions=places)["chosen"] == [1, 2]
    assert cover("--spacing", "30", positions=places) == 2
    assert len(cover("--spacing", "30", "--budget", "3", positions=places)["chosen"]) == 1


def test_a_failure_may_take_only_so_much(cover):
    found = cover("--keep-share", "0.6")
    seen = np.array(SEEN)[found["chosen"]]
    left = [np.delete(seen, k, axis=0).any(axis=0).sum() for k in range(len(seen))]
    assert min(left) >= 0.6 * 6
    assert found["objective"] == found["bound"] == 3


def test_of_the_cheapest_rows_those_that_cover_most_once_more(cover):
    plain, found = cover(), cover("--second", "120")
    assert found["objective"] == plain["objective"]
    assert found["second"]["status"] == "optimal"
    assert found["second"]["covered_once_more"] == found["second"]["bound_once_more"]


def test_a_second_objective_goes_with_no_budget(cover, capsys):
    assert cover("--second", "5", "--budget", "2") == 2
    assert "--second" in capsys.readouterr().err


def test_curve_and_alternatives(cover):
    found = cover("--curve", "5", "--alternatives")
    assert [(p["budget"], p["covered"], p["bound"]) for p in found["curve"]] == [
        (1, 3, 3),
        (2, 6, 6),
    ]
    assert found["chosen"] == [0, 2]
    assert found["alternatives"] == [[1], []]


@pytest.mark.parametrize(
    ("options", "arrays", "message"),
    [
        (["--price", "0"], {}, "--price: is no price"),
        (["--keep-share", "2"], {}, "keep: is no share"),
        (["--curve", "1"], {}, "--curve: is too small"),
        (["--curve", "3", "--price", "1"], {}, "--curve: goes with no --price"),
        (["--spacing", "3"], {}, "--spacing and --positions: go together"),
        (["--spacing", "-1"], {"positions": np.zeros((5, 2))}, "--spacing: is no distance"),
        (["--spacing", "1"], {"positions": np.zeros((4, 2))}, "has no x and y for each row"),
        ([], {"weights": [1.0, 2.0]}, "has no number for each target"),
        (["--budget", "1"], {"mandatory": [0, 1]}, "do not fit the budget"),
        ([], {"needs": [3, 1, 1, 1, 1, 1]}, "1 of 6 targets cannot be covered often enough"),
    ],
)
def test_refuses(cover, capsys, options, arrays, message):
    assert cover(*options, **arrays) == 2
    assert message in capsys.readouterr().err
