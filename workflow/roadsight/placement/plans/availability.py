"""Plans whose sensors together must see each target with a probability, past the traffic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Floats, Floats32, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part
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


# What several sensors see past the same vehicles.
#
# A vehicle hides a target from a sensor while its middle lies within a span of its lane. Sensors
# whose spans overlap look past the same vehicles: they are hidden together more often than
# independent sensors would be.

# Of more sensors that see a target, those with the greatest free shares count: work doubles with
# each sensor.
MOST_SENSORS = 12
_MOST_SPANS = 64  # of one line of sight, of all lanes and classes; any more are left out
_STEP_M = 0.25  # steps along lines of sight in plan: those of `free_shares`, so that both agree


def spans_in_the_way(traffic: Traffic, sensor_m: Floats, targets_m: Floats) -> list[Floats]:
    """Where vehicles' middles hide each target from a sensor.

    The line is walked as `free_shares` walks it; per_m times the lengths of the spans is what that
    function adds up, except that a lane which the line enters twice counts a vehicle once.

    Parameters
    ----------
    sensor_m : (3,). targets_m : (n, 3) the points looked at. Local metres.

    Returns
    -------
    for each target (k, 4): number of the lane, number of the class, lowest and highest station, m
    """
    found, count = _spans(traffic, sensor_m, targets_m)
    return [found[n, : count[n]] for n in range(len(found))]


def shares_alone(traffic: Traffic, sensor_m: Floats, targets_m: Floats) -> Floats:
    """Share of the time (n,) in which no vehicle hides each target, by the same spans."""
    found, count = _spans(traffic, sensor_m, targets_m)
    lane, kind = found[:, :, 0].astype(np.int64), found[:, :, 1].astype(np.int64)
    number = traffic.per_m[lane, kind] * (found[:, :, 3] - found[:, :, 2])
    return np.exp(-np.where(np.arange(_MOST_SPANS) < count[:, None], number, 0.0).sum(axis=1))


def _spans(traffic: Traffic, sensor_m: Floats, targets_m: Floats) -> tuple[Floats, Ints]:
    boxes = np.array([[v.length_m, v.width_m, v.height_m] for v in traffic.vehicles])
    grid = traffic.grid
    return _walk(
        traffic.lane,
        traffic.station_m,
        traffic.offset_m,
        traffic.ground_m,
        (grid.west, grid.south, grid.cell_size_m),
        boxes,
        np.asarray(sensor_m, np.float64),
        np.ascontiguousarray(targets_m, np.float64).reshape(-1, 3),
    )


def joint_share(spans: Sequence[Floats], per_m: Floats) -> float:
    """Share of the time in which at least one sensor sees a target.

    With N(A) the vehicles in a set A of spans, the share in which all are hidden is
    sum over sets S of sensors of (-1)^|S| exp(-mean N(union of their spans)). By Harris' inequality
    the result is never more than that of independent sensors, 1 - prod(1 - p).

    Parameters
    ----------
    spans : of each sensor that sees the target, as `spans_in_the_way` gives them.
    per_m : (lanes, classes) vehicles on a metre.
    """
    used = list(spans)
    if len(used) > MOST_SENSORS:
        mean = [per_m[p[:, 0].astype(np.int64), p[:, 1].astype(np.int64)] for p in used]
        hidden = [float((m * (p[:, 3] - p[:, 2])).sum()) for m, p in zip(mean, used, strict=True)]
        used = [used[k] for k in np.argsort(hidden, kind="stable")[:MOST_SENSORS]]
    if not used:
        return 0.0
    owner = np.repeat(np.arange(len(used)), [len(part) for part in used])
    table = np.concatenate(used)
    if len(set(owner.tolist())) < len(used):
        return 1.0  # nothing can hide the target from one of them
    return float(_seen_by_any(table, owner, np.ascontiguousarray(per_m), len(used)))


def contains(outer: Floats, inner: Floats) -> bool:
    """Whether each span of ``inner`` lies within one of ``outer``."""
    if not len(inner):
        return True
    same = (outer[None, :, :2] == inner[:, None, :2]).all(axis=2)
    within = (outer[None, :, 2] <= inner[:, None, 2]) & (outer[None, :, 3] >= inner[:, None, 3])
    return bool((same & within).any(axis=1).all())


@compiled()
def _seen_by_any(spans: Floats, owner: Ints, per_m: Floats, sensors: int) -> float:
    """One minus the share of the time in which all of the sensors are hidden."""
    sets = 1 << sensors
    mass = np.zeros(sets)  # mean number of vehicles that hide exactly the sensors of a set
    for lane in range(per_m.shape[0]):
        for kind in range(per_m.shape[1]):
            rows = np.flatnonzero((spans[:, 0] == lane) & (spans[:, 1] == kind))
            if len(rows) == 0:
                continue
            ends = np.sort(np.concatenate((spans[rows, 2], spans[rows, 3])))
            for k in range(len(ends) - 1):
                length = ends[k + 1] - ends[k]
                middle, hidden = (ends[k] + ends[k + 1]) / 2, 0
                for row in rows:
                    if spans[row, 2] <= middle <= spans[row, 3]:
                        hidden |= 1 << owner[row]
                if hidden:
                    mass[hidden] += per_m[lane, kind] * length
    total = mass.sum()
    for bit in range(sensors):  # mass of all subsets of each set
        for which in range(sets):
            if which & (1 << bit):
                mass[which] += mass[which ^ (1 << bit)]
    none = 0.0
    for which in range(sets):
        odd, rest = False, which
        while rest:
            rest &= rest - 1
            odd = not odd
        share = np.exp(mass[sets - 1 - which] - total)
        none += -share if odd else share
    return min(max(1.0 - none, 0.0), 1.0)


@compiled_part()
def _joined(spans: Floats, count: int, lane: int, kind: int, start: float, end: float) -> int:
    """Number of spans once one is added: it grows one of its lane and class that it meets."""
    for k in range(count):
        span = spans[k]
        if span[0] == lane and span[1] == kind and start <= span[3] and end >= span[2]:
            span[2], span[3] = min(span[2], start), max(span[3], end)
            return count
    if count == len(spans):
        return count
    spans[count, 0], spans[count, 1], spans[count, 2], spans[count, 3] = lane, kind, start, end
    return count + 1


@compiled()
def _walk(
    lane: Ints32,
    station_m: Floats32,
    offset_m: Floats32,
    ground_m: Floats32,
    corner: tuple[int, int, float],
    boxes: Floats,
    sensor: Floats,
    targets: Floats,
) -> tuple[Floats, Ints]:
    """Spans (n, 64, 4) and their number (n,)."""
    found = np.zeros((len(targets), _MOST_SPANS, 4))
    count = np.zeros(len(targets), np.int64)
    west, south, size = corner
    for target in range(len(targets)):
        way = sensor - targets[target]
        steps = max(int(np.ceil(np.sqrt(way[0] ** 2 + way[1] ** 2) / _STEP_M)), 1)
        for kind in range(len(boxes)):
            long, half, high = boxes[kind, 0], boxes[kind, 1] / 2, boxes[kind, 2]
            current, own, first, last, low, top = -1, True, 0.0, 0.0, 0.0, 0.0
            for step in range(steps + 1):
                at = targets[target] + way * ((step + 0.5) / steps)
                column = int(np.floor(at[0] / size)) - west
                row = int(np.floor(at[1] / size)) - south
                here = -1
                if (
                    step < steps
                    and 0 <= row < lane.shape[0]
                    and 0 <= column < lane.shape[1]
                    and abs(offset_m[row, column]) <= half
                    and at[2] - ground_m[row, column] < high
                ):
                    here = lane[row, column]
                if here != current:
                    if current >= 0:
                        start, end = low - long / 2, top + long / 2
                        if own:  # vehicles leave the target its place
                            ahead = last >= first
                            start = first + long / 2 if ahead else first - long / 2 - (top - low)
                            end = start + (top - low)
                        count[target] = _joined(
                            found[target], count[target], current, kind, start, end
                        )
                    if current >= 0 or step > 0:
                        own = False
                    current = here
                    if here >= 0:
                        first = low = top = float(station_m[row, column])
                if here >= 0:
                    last = float(station_m[row, column])
                    low, top = min(low, last), max(top, last)
    return found, count
