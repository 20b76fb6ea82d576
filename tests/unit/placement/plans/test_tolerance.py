import numpy as np
import pytest
from scipy import sparse

from roadsight.placement.plans.tolerance import (
    changes,
    lost_shares,
    solve_with_tolerance,
    tolerance_of,
)
from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit


def test_fourteen_ways():
    ways = changes(0.2, 1.0, 0.5)
    assert len(ways) == 14
    assert {way.kind for way in ways} == {
        "moved by 0.2 m",
        "turned by 1 degree",
        "mast 0.5 m lower or higher",
    }
    assert sum(np.any(way.shift_m) for way in ways) == 8


def test_losses_are_of_one_sensor_at_a_time():
    seen = np.array([[1, 1, 1, 0], [0, 0, 1, 1]], bool)
    one = changes(0.2, 1.0, 0.5)[0]
    changed = {
        0: [(one, np.array([1, 0, 0, 0], bool))],  # loses 1; 2 is the other's as well
        1: [(one, np.array([0, 0, 0, 1], bool))],
    }
    found = tolerance_of(seen, changed)
    moved, out = found.rows
    assert (moved["lost"], moved["share"], moved["sensor"]) == (1, 0.25, 0)
    assert moved["mean_lost"] == 0.5
    assert (out["kind"], out["lost"], out["sensor"]) == ("one sensor out", 2, 0)
    assert found.times_lost.tolist() == [0, 1, 0, 0]
    assert found.lost_alone.tolist() == [True, True, False, True]
    shares = lost_shares(found.times_lost, found.lost_alone, found.cases)
    assert shares == pytest.approx([1 / 3, 2 / 3, 0, 1 / 3])


def best(matrix):
    cover = solve_cover_problem(
        CoverProblem(matrix, np.ones(matrix.shape[0])), WorkLimit(20), seed=1
    )
    return None if not len(cover.chosen) else np.asarray(cover.chosen)


class TestPlansWithTolerance:
    def problem(self, seed):
        rng = np.random.default_rng(seed)
        rows = rng.random((25, 40)) < 0.25
        rows[0] |= ~rows.any(axis=0)
        kept = rows & (rng.random(rows.shape) < 0.8)
        for target in np.flatnonzero(~kept.any(axis=0)):
            kept[np.flatnonzero(rows[:, target])[0], target] = True
        return sparse.csr_matrix(rows), kept

    @pytest.mark.parametrize("seed", range(6))
    def test_the_cover_is_that_of_all_rows_with_tolerance(self, seed):
        matrix, kept = self.problem(seed)
        looked = []

        def look(row):
            looked.append(row)
            return kept[row]

        reduced, known, _, exact = solve_with_tolerance(matrix, best, look)
        assert exact
        assert len(looked) == len(set(looked)) == known.sum() <= 25
        chosen = best(reduced)
        assert kept[chosen].any(axis=0).all()
        assert len(chosen) == len(best(sparse.csr_matrix(kept)))

    def test_few_rounds_leave_rows_that_were_looked_at(self, monkeypatch):
        monkeypatch.setattr("roadsight.placement.plans.tolerance._MOST_ROUNDS", 1)
        matrix, kept = self.problem(1)
        reduced, known, rounds, exact = solve_with_tolerance(matrix, best, lambda r: kept[r])
        assert (rounds, exact) == (1, False)
        assert set(np.flatnonzero(np.diff(reduced.indptr))) <= set(np.flatnonzero(known))
