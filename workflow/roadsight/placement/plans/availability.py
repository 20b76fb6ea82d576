"""Plans whose sensors together must see each target with a probability, past the traffic."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Floats, Ints
from roadsight.placement.sight.common_traffic import (
    MOST_SENSORS,
    contains,
    joint_share,
    shares_alone,
    spans_in_the_way,
)
from roadsight.placement.sight.lanes import Traffic
from roadsight.setcover.plans.joint import JointProblem

# Greatest share that a sensor's gain -log(1 - p) is taken of: certainty would gain without end, and
# a share that is stored as float32 is never certain.
_MOST_SHARE = 1 - 1e-9
_TOLERANCE = 1e-9  # rounding of joint shares: a target that lacks no more of the level reaches it
# Targets for which a round adds a constraint, those that lack the most. With more of them there are
# fewer rounds, each with a larger problem.
_CUTS = 40
# Limits of the classes in which availability is counted.
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999, 1.0)


def share_matrix(
    detections: pd.DataFrame, choices: pd.MultiIndex, targets: pd.Index
) -> sparse.csr_matrix:
    """How often each choice sees each target, (choices, targets); as `detection_matrix`.

    Parameters
    ----------
    detections : columns sensor, candidate, target and availability; 1 where there is no traffic.
    """
    pairs = pd.MultiIndex.from_frame(detections[["sensor", "candidate"]].astype(str))
    rows = choices.get_indexer(pairs)
    columns = targets.get_indexer(pd.Index(detections["target"].astype(str)))
    shares = np.ones(len(detections))
    if "availability" in detections:
        shares = detections["availability"].to_numpy(np.float64)
    known = (rows >= 0) & (columns >= 0) & (shares > 0)
    shape = (len(choices), len(targets))
    return sparse.csr_matrix((shares[known], (rows[known], columns[known])), shape=shape)


def past_traffic(
    seen: sparse.csr_matrix, traffic: Traffic, sensors_m: Floats, points_m: Floats
) -> sparse.csr_matrix:
    """Shares of the entries of ``seen`` as `CommonTraffic` knows them: exactly, and never more."""
    shares = sparse.csr_matrix(seen, dtype=np.float64, copy=True)
    place = _places(sensors_m)
    # All choices at one place look past the same vehicles.
    for rows in np.split(np.argsort(place, kind="stable"), np.cumsum(np.bincount(place))[:-1]):
        if not len(rows):
            continue
        parts = [slice(shares.indptr[row], shares.indptr[row + 1]) for row in rows]
        targets = [shares.indices[part] for part in parts]
        once, where = np.unique(np.concatenate(targets), return_inverse=True)
        free = shares_alone(traffic, sensors_m[rows[0]], points_m[once])[where]
        ends = np.cumsum([len(part) for part in targets])
        for part, found in zip(parts, np.split(free, ends[:-1]), strict=True):
            shares.data[part] = found
    return shares


def _places(sensors_m: Floats) -> Ints:
    """Number of the place (choices,) at which each choice stands: poses share theirs."""
    return np.unique(sensors_m, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


@dataclass(frozen=True)
class AtLevel:
    """The covering problem of a level, and the targets that cannot reach it.

    ``below`` are numbers of the targets whose level is out of reach even for all candidates
    together; one sensor that sees them will do.
    """

    problem: JointProblem
    below: Ints


def at_level(shares: sparse.csr_matrix, costs: Floats, positions: Ints, level: float) -> AtLevel:
    """Problem in which independent sensors see each target with probability ``level``.

    sum -log(1 - p_i) x_i >= -log(1 - level), one sensor at a position.
    """
    gain = shares.copy()
    gain.data = -np.log1p(-np.minimum(shares.data, _MOST_SHARE))
    need = np.full(shares.shape[1], -np.log1p(-level))
    short = ~JointProblem(gain, need, costs, positions).reachable()
    below = np.flatnonzero(short)
    ends = np.repeat(np.arange(gain.shape[0]), np.diff(gain.indptr))
    data = np.where(short[gain.indices], need[gain.indices], gain.data)
    gain = sparse.csr_matrix((data, (ends, gain.indices)), shape=gain.shape)
    return AtLevel(JointProblem(gain, need, costs, positions), below)


@dataclass
class CommonTraffic:
    """Sensors that look past the same vehicles, as an oracle of `solve_joint`.

    Parameters
    ----------
    traffic : lanes. sensors_m : (choices, 3). points_m : (targets, 3) that are looked at.
    shares : (choices, targets) as `share_matrix` gives them. level : of the plan.
    below : numbers of targets of which no level is asked.
    """

    traffic: Traffic
    sensors_m: Floats
    points_m: Floats
    shares: sparse.csr_matrix
    level: float
    below: Ints
    given_up: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._by_target = self.shares.tocsc()
        self._place = _places(self.sensors_m).tolist()
        self._spans: dict[tuple[int, int], Floats] = {}
        self.given_up |= set(self.below.tolist())

    def joint_shares(self, chosen: Ints) -> Floats:
        """How often at least one of chosen rows sees each target (targets,)."""
        # Spans of all targets that a row sees are found together.
        for row in chosen.tolist():
            targets = self.shares.indices[self.shares.indptr[row] : self.shares.indptr[row + 1]]
            place = self._place[row]
            new = [int(t) for t in targets if (place, int(t)) not in self._spans]
            if new:
                found = spans_in_the_way(self.traffic, self.sensors_m[row], self.points_m[new])
                self._spans |= {(place, t): s.copy() for t, s in zip(new, found, strict=True)}
        rows, per_m = self.shares[chosen].tocsc(), self.traffic.per_m
        return np.array(
            [
                joint_share([self._span(int(chosen[k]), t) for k in _column(rows, t)], per_m)
                for t in range(len(self.points_m))
            ]
        )

    def __call__(self, chosen: Ints) -> list[Ints]:
        """Sets of rows of which one more is needed: for the targets that lack the most."""
        seen = self.joint_shares(chosen)
        lacking = np.flatnonzero(seen < self.level - _TOLERANCE)
        lacking = lacking[[int(t) not in self.given_up for t in lacking]]
        worst = lacking[np.argsort(seen[lacking], kind="stable")][:_CUTS]
        cuts: dict[bytes, Ints] = {}
        for target in worst.tolist():
            rows = _column(self._by_target, target)
            useless = self._of_no_help(target, rows, chosen)
            cut: Ints = rows[~np.isin(rows, useless)]
            if not len(cut):
                self.given_up.add(target)
                continue
            cuts.setdefault(cut.tobytes(), cut)
        return list(cuts.values())

    def _of_no_help(self, target: int, rows: Ints, chosen: Ints) -> Ints:
        """Rows that all together leave a target below the level, the chosen ones among them.

        The chosen rows are joined by others as long as the level is not reached, and by those that
        are hidden whenever one of these is.
        """
        per_m = self.traffic.per_m
        spans = {int(row): self._span(int(row), target) for row in rows}
        inside = rows[np.isin(rows, chosen)].tolist()
        others = [int(row) for row in rows if int(row) not in inside]
        alone = {row: joint_share([spans[row]], per_m) for row in others}
        for row in sorted(others, key=lambda r: (alone[r], r)):
            if len(inside) >= MOST_SENSORS:
                break
            together = joint_share([spans[r] for r in [*inside, row]], per_m)
            if together < self.level - _TOLERANCE:
                inside.append(row)
        covered = [
            row
            for row in others
            if row not in inside and any(contains(spans[row], spans[one]) for one in inside)
        ]
        return np.array([*inside, *covered], np.int64)

    def _span(self, row: int, target: int) -> Floats:
        key = (self._place[row], target)
        if key not in self._spans:
            point = self.points_m[target : target + 1]
            self._spans[key] = spans_in_the_way(self.traffic, self.sensors_m[row], point)[0].copy()
        return self._spans[key]


def _column(matrix: sparse.csc_matrix, column: int) -> Ints:
    rows = matrix.indices[matrix.indptr[column] : matrix.indptr[column + 1]]
    return np.sort(rows).astype(np.int64)


def counted_shares(shares: Floats) -> dict[str, list[float]]:
    """Targets by availability, in the classes of `EDGES`."""
    counts = np.histogram(shares, EDGES)[0]
    return {"edges": list(EDGES), "targets": counts.astype(int).tolist()}
