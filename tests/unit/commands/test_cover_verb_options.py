import itertools
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

    def run(*options, sees=SEEN, **arrays):
        sparse.save_npz(matrix, sparse.csr_matrix(np.array(sees)))
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
    # Rows 0 and 2 cover nothing twice; row 0 and one that reaches over as far do.
    wide = [[1, 1, 1, 0, 0, 0], [1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 1], [0, 0, 1, 1, 1, 1],
            [0, 1, 1, 1, 1, 1]]  # fmt: skip
    plain, found = cover(sees=wide), cover("--second", "120", sees=wide)
    assert plain["objective"] == found["objective"] == 2
    assert plain["chosen"] != found["chosen"] == [0, 4]
    second = {"covered_once_more": 2, "bound_once_more": 2, "covered_twice_more": 0}
    assert found["second"] == second | {"status": "optimal"}
    assert "second" not in plain


def test_a_second_objective_is_the_same_every_time_and_counted_in(cover, monkeypatch):
    """Its limit counts work, so that a clock that stands still changes nothing."""
    rng = np.random.default_rng(5)
    at, place = rng.random(60) * 40, rng.random(200) * 40
    near = np.abs(at[:, None] - place) < 6
    near[np.arange(200) % 60, np.arange(200)] = True
    found = cover("--second", "0.05", sees=near)
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    monkeypatch.setattr("time.process_time", itertools.count().__next__)
    again = cover("--second", "0.05", sees=near)
    assert again["chosen"] == found["chosen"]
    assert again["second"] == found["second"]
    # A clock that moves by 1 s whenever it is read: once each for cover and second objective.
    assert again["seconds_cpu"] >= 2


@pytest.mark.parametrize(
    "options",
    [["--second", "0"], ["--second", "nan"], ["--second", "5", "--keep-share", "0.5"],
     ["--curve", "1"], ["--curve", "3", "--price", "1"]],
)  # fmt: skip
def test_what_is_added_is_checked_before_anything_is_read(options, tmp_path, capsys):
    argv = ["cover", str(tmp_path / "no.npz"), *options, "-o", str(tmp_path / "s.json")]
    assert main(argv) == 2
    assert options[0] in capsys.readouterr().err


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


def test_highs_solves_and_checks_as_we_do(cover, capsys):
    own = cover("--verify", "10")
    theirs = cover("--solver", "highs")
    assert (own["solver"], own["proved_by"], theirs["solver"]) == ("own", "own", "highs")
    assert own["verified"]["result"] == "confirmed"
    assert own["objective"] == theirs["objective"] == theirs["bound"] == 2
    budget = ("--budget", "1", "--keep-share", "0", "--curve", "2")
    curves = [cover(*budget, "--solver", solver)["curve"] for solver in ("own", "highs")]
    assert [p["covered"] for p in curves[0]] == [p["covered"] for p in curves[1]]
    assert cover("--verify", "0") == 2
    assert "--verify: is no time" in capsys.readouterr().err


def test_a_check_that_is_stopped_at_once_has_no_bound_yet(cover):
    rng = np.random.default_rng(0)
    sees = rng.random((120, 400)) < 0.04
    sees[rng.integers(0, 120, 400), np.arange(400)] = True
    found = cover("--verify", "1e-9", "--time-limit", "1", sees=sees.astype(float))
    assert found["verified"]["bound"] <= found["bound"]


def test_highs_is_not_asked_of_numbers_too_far_apart(cover, capsys):
    costs = [1.0, 1.0, 1.0, 1.0, 1e10]
    assert cover("--solver", "highs", costs=costs) == 2
    message = capsys.readouterr().err
    assert "too far apart for HiGHS" in message
    assert "1e+10 times" in message
    found = cover("--verify", "10", costs=costs)
    assert (found["objective"], found["status"]) == (2, "optimal")
    assert found["verified"]["result"].startswith("not checked")
