"""``truth.csv``: one row a data set and metric, and one named ``mean`` per metric."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from roadsight.evidence.truth.catalogue import Area, Metric

COLUMNS = (
    "area",
    "dataset",
    "metric",
    "unit",
    "ours",
    "peer",
    "peer_name",
    "published",
    "goal",
    "cpu_s",
)
MEAN = "mean"


@dataclass(frozen=True)
class Figure:
    """A metric on one data set: ours, and the peer's where it has one.

    Parameters
    ----------
    cpu_s : processor time that ours took.
    """

    metric: str
    ours: float
    peer: float | None = None
    cpu_s: float | None = None


def truth_rows(name: str, area: Area, measured: Mapping[str, Sequence[Figure]]) -> pd.DataFrame:
    """Rows of an area, of the columns `COLUMNS`.

    Parameters
    ----------
    measured : figures by data set. A data set of the catalogue that is not among them is missing:
        its rows have no figures, and the mean is over those that are there.
    """
    rows: list[dict[str, Any]] = []
    for metric, about in area.metrics.items():
        own = [
            (dataset, figure)
            for dataset in area.datasets
            for figure in measured.get(dataset, ())
            if figure.metric == metric
        ]
        rows += [_row(name, area, dataset, figure, about, about.each) for dataset, figure in own]
        if about.mean and own:
            # The peer has a mean where it measured every data set.
            ours = [figure.ours for _, figure in own]
            peers = [figure.peer for _, figure in own if figure.peer is not None]
            times = [figure.cpu_s for _, figure in own if figure.cpu_s is not None]
            peer = sum(peers) / len(own) if len(peers) == len(own) else None
            mean = Figure(metric, sum(ours) / len(own), peer, sum(times) if times else None)
            rows.append(_row(name, area, MEAN, mean, about, about.goal))
    rows += [
        {"area": name, "dataset": dataset, "metric": "missing", "peer_name": area.peer}
        for dataset in area.datasets
        if dataset not in measured
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def holds(value: float, goal: str) -> bool | None:
    """Whether a value keeps a goal such as ``<4.0``; None where there is none, or no value."""
    if not goal or not math.isfinite(value):
        return None
    limit = float(goal[1:])
    return value < limit if goal[0] == "<" else value > limit


def _row(
    name: str, area: Area, dataset: str, figure: Figure, about: Metric, goal: str
) -> dict[str, Any]:
    return {
        "area": name,
        "dataset": dataset,
        "metric": figure.metric,
        "unit": about.unit,
        "ours": figure.ours,
        "peer": figure.peer,
        "peer_name": area.peer if figure.peer is not None else "",
        "published": about.published if dataset == MEAN or len(area.datasets) == 1 else None,
        "goal": goal if dataset == MEAN or goal else "",
        "cpu_s": figure.cpu_s,
    }
