"""Both studies side by side: what they published, ours as published, ours by default.

``snakemake paper`` runs generated sites twice, with `config/published.yaml` and with the default
settings, and a few steps more often. This module says which runs there are and makes the rows of
``paper.csv`` from what they measured; `roadsight.report.paper_page` draws them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from scipy.spatial import cKDTree

from roadsight.evidence import published

# short: small sites, a quarter of an hour of processor time; long: as large as the studies'.
Size = Literal["short", "long"]
# What `roadsight.stages.evidence.measure_paper` wrote, by run.
Measured = Mapping[str, Mapping[str, Any]]
# Of ``paper.csv``.
COLUMNS = (
    "study", "item", "site", "row", "quantity", "unit", "published", "as_published", "default",
    "cpu_s_as_published", "cpu_s_default",
)  # fmt: skip
NATIVE_PX = 416  # Height of the generated images.
PUBLISHED_FILE = "config/published.yaml"  # Settings of both studies.
# Generated roads that stand for those of the placement study (its Table 2).
PLACEMENT_SITES = {"site_1": "Site 1", "site_2": "Site 2", "site_3": "Site 3"}
POLE_SITE = "route"  # Generated road that stands for the route of the pole study.
# Deployment plans of the placement study (section 3.3); as published with Table 5's sensors.
PLANS = ("vlp-16", "puck-32c", "puck-32c-or-os-32", "os-32", "os-64", "os-128")
# Site on which the U-Net is deployed; the study shows the same site (Fig. 20a).
NETWORK_SITE = "site_2"
NETWORK_PLANS = ("os-64", "os-128")
NETWORKS = {"unet": "U-Net, end to end", "unet_mask": "U-Net, mask and interpolation"}
HEIGHTS_PX = (256, 512, 1024)
VOXELS_FT = (3, 5, 10)
_FOOT_M = 0.3048
_MILE_KM = 1.609344
_FEWER_CANDIDATES = {"candidates": {"spacing_m": 20, "height_step_m": 6}, "coverage": {"rounds": 1}}
# A depth map by network takes seconds, so that only a few candidates have one.
_FEWEST_CANDIDATES = {
    "candidates": {"spacing_m": 40, "height_step_m": 6},
    "coverage": {"rounds": 0},
}
_FEW_IMAGES = {"videolog": {"every": 4}}
# The pole study's cloud comes with its ground classified; the pillar rule is the other study's.
_CLASSIFIED = {"ground": {"method": "robust"}}


@dataclass(frozen=True)
class Run:
    """One run of a site.

    Parameters
    ----------
    site : key of the site. published : whether `PUBLISHED_FILE` holds. changes : settings on top.
    plans : plans to solve. targets : results that are asked for, below ``results/<site>``.
    """

    site: str
    published: bool = False
    changes: Mapping[str, Any] = field(default_factory=dict)
    plans: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()


def site_name(site: str, size: Size) -> str:
    """Name of a site, as in ``results/<name>`` and ``config/sites/paper``."""
    return f"paper_{site}" if size == "short" else f"paper_{site}_long"


def site_file(site: str, size: Size) -> str:
    """Path of its site file."""
    return f"config/sites/paper/{site}{'' if size == 'short' else '_long'}.yaml"


def site_files() -> list[str]:
    """Files of all sites of both sizes."""
    sites = (*PLACEMENT_SITES, POLE_SITE)
    return [site_file(site, size) for size in get_args(Size) for site in sites]


def runs(size: Size) -> dict[str, Run]:
    """All runs, by name."""
    fewer, fewest, few = (
        ({}, {}, {}) if size == "long" else (_FEWER_CANDIDATES, _FEWEST_CANDIDATES, _FEW_IMAGES)
    )
    found: dict[str, Run] = {}
    changes: Mapping[str, Any]
    for site in PLACEMENT_SITES:
        for way, plans in (("published", _table5(PLANS)), ("default", PLANS)):
            scene = ("scene/pavement_scores.json", "placement/edges.gpkg")
            targets = (*scene, *map(_solution, plans))
            found[f"{site}-{way}"] = Run(site, way == "published", fewer, plans, targets)
    plans = _table5(NETWORK_PLANS)
    for way in ("preliminary", "hybrid", *NETWORKS):
        changes = fewest | {"lidar": {"model": way}}
        found[f"{NETWORK_SITE}-{way}"] = Run(
            NETWORK_SITE, True, changes, plans, tuple(map(_solution, plans))
        )
    validated = ("poles/validation.json", "poles/camera_scores.json")
    found["route-published"] = Run(POLE_SITE, True, _CLASSIFIED, (), validated)
    found["route-default"] = Run(POLE_SITE, False, {}, (), (*validated, "poles/components.json"))
    for feet in VOXELS_FT:
        changes = _CLASSIFIED | {"voxels": {"voxel_size_m": round(feet * _FOOT_M, 4)}}
        found[f"route-voxel_{feet}"] = Run(
            POLE_SITE, True, changes, (), ("poles/road_edges.parquet",)
        )
    for height in (0, *HEIGHTS_PX):
        changes = few | {"networks": {"image_height_px": height or NATIVE_PX}}
        found[f"route-height_{height}"] = Run(
            POLE_SITE, False, changes, (), ("poles/pole_axes/0.parquet",)
        )
    return found


def _table5(plans: Iterable[str]) -> tuple[str, ...]:
    return tuple(f"table5-{plan}" for plan in plans)


def _solution(plan: str) -> str:
    return f"placement/{plan}/solution.json"


def rows(measured: Measured) -> list[dict[str, Any]]:
    """Rows of ``paper.csv``, study by study in the order of their tables and figures."""
    return [
        row
        for item in (
            _sites,
            _pavement,
            _plans,
            _time_curves,
            _networks,
            _components,
            _thresholds,
            _scenarios,
            _stages,
            _heights,
            _voxels,
        )
        for row in item(measured)
    ]


def _row(
    study: str,
    item: str,
    site: str,
    row: str,
    quantity: str,
    unit: str,
    *values: float | None,
    cpu_s: Sequence[float | None] = (None, None),
) -> dict[str, Any]:
    """A row: ``values`` are the published one, ours as published and by default, ``cpu_s`` ours."""
    cells: list[Any] = [study, item, site, row, quantity, unit]
    for value in (*(*values, None, None, None)[:3], *cpu_s):
        # To four significant digits, whole numbers as they are.
        as_is = value is None or not math.isfinite(value) or abs(value) >= 1000
        cells.append(value if as_is else float(f"{value:.4g}"))
    return dict(zip(COLUMNS, cells, strict=True))


def _sites(measured: Measured) -> list[dict[str, Any]]:
    """Placement study, Table 2."""
    found = []
    for site, title in PLACEMENT_SITES.items():
        ours = measured[f"{site}-default"]["facts"]
        theirs = published.SITES[title]
        found += [
            _row("placement", "Table 2", title, name, name, unit, theirs[key], None, ours[key])
            for key, name, unit in published.SITE_FACTS
        ]
    return found


def _pavement(measured: Measured) -> list[dict[str, Any]]:
    """Placement study, Table 4."""
    found = []
    for site, title in PLACEMENT_SITES.items():
        theirs = published.PAVEMENT.get(title, {})
        ways = [measured[f"{site}-{way}"] for way in ("published", "default")]
        cost = tuple(_cpu_s(run, _PAVEMENT_STEPS) for run in ways)
        for key in ("accuracy", "recall", "f1"):
            ours = (100 * run["pavement"][key] for run in ways)
            about = "placement", "Table 4", title, key, key, "%"
            found.append(_row(*about, theirs.get(key), *ours, cpu_s=cost))
    return found


_PAVEMENT_STEPS = ("build_dem", "cluster_fpfh", "extract_pavement")


def _plans(measured: Measured) -> list[dict[str, Any]]:
    """Placement study, Fig. 18a."""
    found = []
    for site, title in PLACEMENT_SITES.items():
        theirs = published.SENSORS[title]
        as_published, default = (measured[f"{site}-{way}"] for way in ("published", "default"))
        for plan, name in zip(PLANS, published.PLANS, strict=True):
            one, other = as_published["plans"][f"table5-{plan}"], default["plans"][plan]
            values = theirs.get(name), one["sensors"], other["sensors"]
            found.append(_row("placement", "Fig. 18", title, name, "sensors", "", *values))
            shares = None, 100 * one["covered_share"], 100 * other["covered_share"]
            found.append(_row("placement", "Fig. 18", title, name, "targets covered", "%", *shares))
    return found


def _time_curves(measured: Measured) -> list[dict[str, Any]]:
    """Placement study, Fig. 19: time of one row of the detection matrix by sensor."""
    found = []
    fast = measured[f"{NETWORK_SITE}-default"]["seconds_per_candidate"]
    for way, title in {"hybrid": "Algorithm 1", **NETWORKS}.items():
        for sensor, cpu_s in measured[f"{NETWORK_SITE}-{way}"]["seconds_per_candidate"].items():
            ours = fast.get(published.PRODUCTS.get(sensor, ""))
            label = f"{title}, {sensor.removeprefix('table5-')}"
            about = "placement", "Fig. 19", PLACEMENT_SITES[NETWORK_SITE], label
            found.append(_row(*about, "time of a candidate", "CPU s", None, cpu_s, ours))
    return found


def _networks(measured: Measured) -> list[dict[str, Any]]:
    """Placement study, Fig. 20: sensors asked for, and how far they stand from the baseline's."""
    found = []
    baseline = measured[f"{NETWORK_SITE}-hybrid"]["plans"]
    for way, title in NETWORKS.items():
        for plan in _table5(NETWORK_PLANS):
            one, other = baseline[plan], measured[f"{NETWORK_SITE}-{way}"]["plans"][plan]
            apart = mean_distance_m(other["sensors_m"], one["sensors_m"])
            label = f"{title}, {plan.removeprefix('table5-').upper()}"
            about = "placement", "Fig. 20", PLACEMENT_SITES[NETWORK_SITE], label
            found.append(_row(*about, "sensors", "", None, other["sensors"]))
            found.append(_row(*about, "sensors of the baseline", "", None, one["sensors"]))
            found.append(_row(*about, "mean distance to the baseline's", "m", None, apart))
    return found


def mean_distance_m(sensors_m: Any, baseline_m: Any) -> float:
    """Mean distance of sensors (n, 3) to the nearest of a baseline (m, 3); section 3.3.2."""
    sensors, others = (np.asarray(part, float).reshape(-1, 3) for part in (sensors_m, baseline_m))
    if not len(sensors) or not len(others):
        return math.nan
    return float(cKDTree(others).query(sensors)[0].mean())


def _components(measured: Measured) -> list[dict[str, Any]]:
    """Pole study, Table 1, which gives no numbers: F1 at 3 m without each component."""
    records = measured["route-default"]["components"]
    found = []
    for one in records:
        name = one["component"]
        label = "with all" if name == "all" else f"without {name.replace('_', ' ')}"
        about = "poles", "Table 1", "Route", label, "F1 at 3 m", ""
        found.append(_row(*about, None, None, one["f1_3m"]))
    return found


def _thresholds(measured: Measured) -> list[dict[str, Any]]:
    """Pole study, Table 2 and Fig. 13."""
    ways = [
        {row["threshold_m"]: row for row in measured[f"route-{way}"]["validation"]["thresholds"]}
        for way in ("published", "default")
    ]
    found = []
    for threshold, theirs in published.SCORES.items():
        for score in ("precision", "recall", "f1"):
            values = theirs[score], *(way[threshold][score] for way in ways)
            found.append(_row("poles", "Table 2", "Route", f"{threshold} m", score, "", *values))
    return found


def _scenarios(measured: Measured) -> list[dict[str, Any]]:
    """Pole study, Table 3 and Fig. 12: mean error by scenario, and its distribution."""
    ways = [measured[f"route-{way}"]["validation"] for way in ("published", "default")]
    found = []
    for name in published.SCENARIOS:
        theirs = published.scenario_mean_m(name)
        ours = [way["scenarios"][name.split(maxsplit=1)[0]] for way in ways]
        about = "poles", "Table 3", "Route", name
        counts = (None if one is None else one["count"] for one in ours)
        found.append(_row(*about, "poles", "", None if theirs is None else theirs[0], *counts))
        means = (None if one is None else one["mean"] for one in ours)
        found.append(_row(*about, "mean error", "m", None if theirs is None else theirs[1], *means))
    for key, quantity, theirs_m in (
        ("geodesic_m", "three quarters of the poles within", published.WITHIN_75_M),
        ("across_m", "the same across the road", published.ACROSS_75_M),
    ):
        values = []
        for way in ways:
            known = [abs(error[key]) for error in way["errors"] if error.get(key) is not None]
            values.append(float(np.quantile(known, 0.75)) if known else None)
        found.append(_row("poles", "Fig. 12", "Route", quantity, quantity, "m", theirs_m, *values))
    mean_m = [way["mean_m"] for way in ways]
    place = "poles", "Fig. 12", "Route", "mean error", "mean error", "m"
    found.append(_row(*place, published.MEAN_M, *mean_m))
    return found


def _stages(measured: Measured) -> list[dict[str, Any]]:
    """Pole study, Table 4: core-minutes of each stage a mile; GPUs count as their cores."""
    ways = [measured[f"route-{way}"] for way in ("published", "default")]
    found = []
    for title, minutes, cores, rules in published.STAGES:
        ours = (_cpu_s(way, rules) / 60 / (way["length_km"] / _MILE_KM) for way in ways)
        about = "poles", "Table 4", "Route", title, "core-minutes a mile", "min"
        found.append(_row(*about, minutes * cores, *ours))
    return found


def _heights(measured: Measured) -> list[dict[str, Any]]:
    """Pole study, section 4.3: images that show fewer poles than at their own height."""
    native = measured["route-height_0"]
    found = []
    for height in (0, *HEIGHTS_PX):
        run = measured[f"route-height_{height}"]
        label = "native" if height == 0 else f"{height} px"
        theirs = published.FEWER_POLES.get(height)
        fewer = fewer_poles_share(run["shown"], native["shown"], native["images"])
        about = "poles", "Image height", "Route", label
        found.append(_row(*about, "images with fewer poles", "%", theirs, None, 100 * fewer))
        cost = _cpu_s(run, ("segment_images",)) / 60 / (run["length_km"] / _MILE_KM)
        minutes = published.HEIGHT_MINUTES[height]
        found.append(_row(*about, "time of a mile", "min", minutes, None, cost))
    return found


def fewer_poles_share(shown: Mapping[str, int], native: Mapping[str, int], images: int) -> float:
    """Share of images that show fewer poles than at their own height."""
    fewer = sum(shown.get(image, 0) < count for image, count in native.items())
    return fewer / images if images else math.nan


def _voxels(measured: Measured) -> list[dict[str, Any]]:
    """Pole study, section 4.3: points and edge points of the raster by voxel size."""
    found = []
    for feet in (1, *VOXELS_FT):
        run = measured["route-published" if feet == 1 else f"route-voxel_{feet}"]
        theirs = published.VOXELS[feet]
        about = "poles", "Voxel size", "Route", f"{feet} ft"
        cost = _cpu_s(run, ("rasterise_lidar",))
        found.append(_row(*about, "points", "", theirs["points"], run["voxels"]))
        found.append(_row(*about, "edge points", "", theirs["edge points"], run["road_edges"]))
        found.append(_row(*about, "time", "s", theirs["seconds"], cost))
    return found


def _cpu_s(run: Mapping[str, Any], rules: Iterable[str]) -> float:
    """Processor time of some rules of a run, s."""
    return math.fsum(run["cpu_s"].get(rule, 0.0) for rule in rules)
