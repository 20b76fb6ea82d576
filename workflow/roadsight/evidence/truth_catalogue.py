"""What is measured on real data: areas, their data sets, metrics, peers, published figures, goals.

Its table ``truth.csv`` has one row a data set and metric, and one named ``mean`` per metric.

The data lie under the folder that ``ROADSIGHT_DATA`` names; nothing here opens them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

# Streets of ``street_scans``: ten frames of a 64-channel scanner with labels and photographs.
STREETS = ("02", "03", "05", "07", "08")
# Samples of the ISPRS comparison of ground filters.
ISPRS = ("samp11", "samp21", "samp31", "samp42", "samp52", "samp53", "samp71")
# Public covering instances.
COVERS = (
    "camera_placement_ac01", "sc_157_0", "sc_1000_11", "sc_330_0", "sc_5000_1", "rail507",
    "scpnrg1", "scpcyc09",
)  # fmt: skip


@dataclass(frozen=True)
class Metric:
    """A figure that is measured on each data set of an area.

    Parameters
    ----------
    unit : of the figure. published : what others report, None where nobody did.
    goal : a number behind ``<`` or ``>`` that the mean must keep; empty: none.
    each : the same for every data set. mean : whether a mean over data sets has a meaning.
    """

    unit: str
    published: float | None = None
    goal: str = ""
    each: str = ""
    mean: bool = True


@dataclass(frozen=True)
class Area:
    """Part of the product that real data judge.

    Parameters
    ----------
    title : for people. peer : what is measured beside it in the same run.
    datasets : patterns of files by name of the data set, relative to the data folder.
    metrics : by name.
    """

    title: str
    peer: str
    datasets: Mapping[str, tuple[str, ...]]
    metrics: Mapping[str, Metric]

    def files(self, dataset: str, data: Path) -> tuple[list[Path], list[str]]:
        """Files of a data set that are there, and the patterns that match nothing."""
        found, missing = [], []
        for pattern in self.datasets[dataset]:
            matches = sorted(path for path in data.glob(pattern) if path.is_file())
            found += matches
            missing += [] if matches else [pattern]
        return found, missing


def _street(name: str, *patterns: str) -> tuple[str, ...]:
    return tuple(f"street_scans/{name}/{pattern}" for pattern in patterns)


_CLOUD = ("frames.laz", "labels.npz", "poses.csv")
_SURVEYS = {
    "delft": ("clouds/delft/cloud.laz", "clouds/delft/bgt_*.sqlite"),
    "amsterdam": ("clouds/amsterdam_poles/cloud.laz", "clouds/amsterdam_poles/roads.csv"),
}
_PHOTOGRAPHS = ("truth_cameras.csv", "images/*.jpg", "masks/*.png", "road_masks/*.png")
AREAS: dict[str, Area] = {
    "ground": Area(
        title="Ground points of a cloud",
        peer="SMRF, fixed parameters",
        datasets={
            **{
                name: (f"clouds/isprs/{name}.laz", f"clouds/isprs/{name}_ground.npz")
                for name in ISPRS
            },
            **{f"street_{name}": _street(name, *_CLOUD) for name in STREETS},
        },
        metrics={
            # Pingel, Clarke, McBride 2013, table 4: 15 samples, one set of parameters.
            "total_error": Metric("%", published=4.4, goal="<4.0"),
            "kappa": Metric("%", published=85.4, goal=">85"),
            "f1": Metric("%", goal=">96"),
        },
    ),
    "pavement": Area(
        title="Pavement of a street",
        peer="all ground is road",
        datasets={**{f"street_{name}": _street(name, *_CLOUD) for name in STREETS}, **_SURVEYS},
        metrics={
            # The study's own two sites: 90.4 and 96.3 %.
            "f1": Metric("%", published=90.4, goal=">85", each=">75"),
            "recall_by_area": Metric("%", goal=">70"),
            "precision_by_area": Metric("%", goal=">85"),
        },
    ),
    "edges": Area(
        title="Road edges beside surveyed ones",
        peer="outline of all ground",
        datasets=_SURVEYS,
        metrics={
            "median_distance": Metric("m", goal="<0.5"),
            "completeness_0.5m": Metric("%"),
            "completeness_1m": Metric("%", goal=">60"),
            "completeness_2m": Metric("%"),
        },
    ),
    "depth": Area(
        title="Depth map beside a real scan that was left out",
        peer="median of the points in a 0.15 degree cone",
        datasets={f"street_{name}": _street(name, *_CLOUD) for name in STREETS},
        metrics={
            "within_0.5m": Metric("%", goal=">92"),
            "within_0.5m_to_20m": Metric("%"),
            "within_0.5m_20_to_40m": Metric("%"),
            "within_0.5m_40_to_90m": Metric("%"),
            "too_near_over_too_far": Metric("ratio", goal="<3", each="<3"),
        },
    ),
    "alignment": Area(
        title="Cameras of single photographs with a known lens, started 2 degrees and 1 m off",
        peer="road edges and pole axes",
        datasets={f"street_{name}": _street(name, *_CLOUD, *_PHOTOGRAPHS) for name in STREETS},
        metrics={
            "within_0.2deg": Metric("%", goal=">90"),
            "median_deg": Metric("deg", goal="<0.1"),
            "accepted": Metric("%"),
            "accepted_within_0.2deg": Metric("%", goal=">98"),
            # Of a normal error 68 and 95 %.
            "within_1_sigma": Metric("%", goal=">60"),
            "within_2_sigma": Metric("%", goal=">90"),
        },
    ),
    "sightings": Area(
        title="Poles from published street-view sightings",
        peer="the published method",
        datasets={"tl50": ("sightings/tl50_sightings.csv", "sightings/tl50_truth.csv")},
        metrics={
            # Means of ten seeds of the published code, one-to-one matches.
            "precision_2m": Metric("ratio", published=0.33),
            "recall_2m": Metric("ratio", published=0.35),
            "precision_4m": Metric("ratio", published=0.54),
            "recall_4m": Metric("ratio", published=0.61),
            "precision_6m": Metric("ratio", published=0.68),
            "recall_6m": Metric("ratio", published=0.74),
        },
    ),
    "cover": Area(
        title="Public covering instances, 60 s each",
        peer="HiGHS",
        datasets={name: (f"setcover/{name}.txt",) for name in COVERS},
        metrics={
            "objective": Metric("cost", mean=False),
            "bound": Metric("cost", mean=False),
            "over_best_known": Metric("%", goal="<0.6"),
        },
    ),
}


COLUMNS = (
    "area", "dataset", "metric", "unit", "ours", "peer", "peer_name", "published", "goal", "cpu_s",
)  # fmt: skip
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
