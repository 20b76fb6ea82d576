"""What a plan loses where its sensors do not stand exactly as planned, and plans that lose nothing.

A mast stands some decimetres beside its place, a sensor leans by a degree, a mast comes in another
height, a sensor fails. Each is looked at alone: one sensor as it may be, all others as planned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.placement.sensors.poses import AS_MOUNTED, Turn

OUT = "out"  # name of the change of a sensor that fails
# Covers that are tried with rows as they are seen with tolerance, before only rows that were looked
# at may be chosen: the test sites needed 3 to 20.
_MOST_ROUNDS = 60


@dataclass(frozen=True)
class Change:
    """One way in which a sensor is not as planned.

    Parameters
    ----------
    kind : what is told of it. name : what it is exactly.
    shift_m : along the sensor's x (to the road), y and z. turn : of the sensor.
    """

    kind: str
    name: str
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: Turn = AS_MOUNTED


def changes(move_m: float, turn_deg: float, height_m: float) -> list[Change]:
    """The ways that are looked at: six of moving, six of turning, two of another mast."""
    moved, turned, mast = (
        f"moved by {move_m:g} m",
        f"turned by {turn_deg:g} degree{'' if turn_deg == 1 else 's'}",
        f"mast {height_m:g} m lower or higher",
    )
    found = []
    for axis, names in enumerate((("back", "forward"), ("right", "left"), ("down", "up"))):
        for sign, name in zip((-1.0, 1.0), names, strict=True):
            shift = [0.0, 0.0, 0.0]
            shift[axis] = sign * move_m
            found.append(Change(moved, name, (shift[0], shift[1], shift[2])))
    for axis, what in enumerate(("yaw", "pitch", "roll")):
        for sign in (-1.0, 1.0):
            angles = [0.0, 0.0, 0.0]
            angles[axis] = sign * turn_deg
            found.append(Change(turned, f"{what} {sign * turn_deg:+g}", turn=Turn(*angles)))
    for sign, name in ((-1.0, "lower"), (1.0, "higher")):
        found.append(Change(mast, name, (0.0, 0.0, sign * height_m)))
    return found


@dataclass(frozen=True)
class Tolerance:
    """What a plan loses.

    Parameters
    ----------
    rows : one for each kind of change: kind, lost (targets, in the worst case), share (of those
        that the plan sees), sensor (number from 0) and name of the worst case, mean_lost.
    times_lost : (targets,) changes by which each target is lost, "one sensor out" left out.
    lost_alone : (targets,) whether it is lost when one of the sensors is out.
    cases : how many changes there were, of all sensors.
    """

    rows: list[dict[str, Any]]
    times_lost: Ints
    lost_alone: Bools
    cases: int


def tolerance_of(seen: Bools, changed: dict[int, list[tuple[Change, Bools]]]) -> Tolerance:
    """Losses of a plan.

    Parameters
    ----------
    seen : (sensors, targets) as planned.
    changed : what each sensor that was looked at sees under each change, (targets,) each.
    """
    times = seen.sum(axis=0)
    before = times > 0
    count = max(int(before.sum()), 1)
    cases: dict[str, list[tuple[int, int, str]]] = {}
    times_lost = np.zeros(seen.shape[1], np.int64)
    for sensor, found in changed.items():
        others = (times - seen[sensor]) > 0
        for change, sees in found:
            lost = before & ~others & ~sees
            times_lost += lost
            cases.setdefault(change.kind, []).append((int(lost.sum()), sensor, change.name))
    for sensor in range(len(seen)):
        lost = before & (times - seen[sensor] == 0)
        cases.setdefault("one sensor out", []).append((int(lost.sum()), sensor, OUT))
    rows = []
    for kind, losses in cases.items():
        lost, sensor, name = max(losses, key=lambda loss: (loss[0], -loss[1]))
        mean = float(np.mean([loss[0] for loss in losses]))
        rows.append(
            {
                "kind": kind,
                "lost": lost,
                "share": lost / count,
                "sensor": sensor,
                "name": name,
                "mean_lost": mean,
            }
        )
    number = sum(len(found) for found in changed.values())
    return Tolerance(rows, times_lost, times == 1, number)


# Chosen rows of a matrix; None where no choice sees everything.
Solve = Callable[[sparse.csr_matrix], Ints | None]
Look = Callable[[int], Bools]  # what a row sees under every change at once (targets,)


def solve_with_tolerance(
    matrix: sparse.csr_matrix, solve: Solve, look: Look
) -> tuple[sparse.csr_matrix, Bools, int, bool]:
    """Rows reduced to what they see with tolerance, as far as covers ask for them.

    Looking at all candidates under all changes costs fourteen times their depth maps. Only those
    that a cover chooses are looked at; the cover is asked again with what they keep, until it
    chooses none that is not known. Rows that were not looked at see too much, so that each cover is
    a relaxation: the last one is the best of all, and its proof holds.

    Returns
    -------
    the matrix, (rows,) which were looked at, rounds, and whether the last cover is exact; if not,
    the rounds ran out, and only rows that were looked at see anything.
    """
    rows = matrix.tolil(copy=True)
    known = np.zeros(matrix.shape[0], bool)
    for number in range(1, _MOST_ROUNDS + 1):
        current = rows.tocsr()
        chosen = solve(current)
        if chosen is None:
            return current, known, number, True
        new = [int(row) for row in chosen if not known[row]]
        if not new:
            return current, known, number, True
        for row in new:
            kept = np.flatnonzero(np.asarray(matrix[row].todense()).ravel() & look(row))
            rows.rows[row] = kept.tolist()
            rows.data[row] = [True] * len(kept)
            known[row] = True
    for row in np.flatnonzero(~known).tolist():
        rows.rows[row], rows.data[row] = [], []
    return rows.tocsr(), known, _MOST_ROUNDS, False


def lost_shares(times_lost: Ints, lost_alone: Bools, cases: int) -> Floats:
    """Share of the changes (targets,) that lose each target, for the map; a failure counts once."""
    return (times_lost + lost_alone) / max(cases + 1, 1)
