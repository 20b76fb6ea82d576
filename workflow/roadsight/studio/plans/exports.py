"""Sensors of a what-if, and the plan that asks for them, as files to take away."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal

import geopandas as gpd
import numpy as np
import yaml

from roadsight.base.errors import InputError
from roadsight.io.vector.vectors import write_geojson
from roadsight.studio.plans.plan_bodies import PlanBody
from roadsight.studio.plans.plan_files import plan_value
from roadsight.studio.project import SiteFolder
from roadsight.studio.results.layout import Layout, WhatIf

TYPES = {"csv": "text/csv", "geojson": "application/geo+json", "yaml": "application/yaml"}


class Export(WhatIf):
    """Sensors that are to be written, and how."""

    format: Literal["csv", "geojson", "yaml"]


def exported(site: SiteFolder, plan: str, layout: Layout, asked: Export) -> tuple[str, bytes]:
    """Name and content of the file.

    The table has columns that ``mandatory`` of a plan reads; the plan names it.

    Raises
    ------
    InputError : no such candidates, two sensors that exclude each other, or a plan of none.
    """
    rows = np.array(asked.rows, np.int64)
    layout.coverage(rows)  # refuses what cannot stand
    table_name = f"{site.stem}-{plan}-sensors.csv"
    if asked.format == "yaml":
        text = _plan_text(site, plan, table_name, len(rows))
        return f"{site.stem}-{plan}-plan.yaml", text.encode()
    features = _features(layout, rows)
    name = table_name if asked.format == "csv" else f"{site.stem}-{plan}-sensors.geojson"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if asked.format == "geojson":
            write_geojson(path, features, layout.frame)
        else:
            xyz = features.geometry.get_coordinates(include_z=True).to_numpy(np.float64)
            table = features.drop(columns="geometry")
            table[["x", "y", "z"]] = layout.frame.to_native(xyz).round(3)
            table.to_csv(path, index=False, lineterminator="\n")
        return name, path.read_bytes()


def _features(layout: Layout, rows: np.ndarray) -> gpd.GeoDataFrame:
    places = layout.places.iloc[rows]
    points = gpd.points_from_xy(places["x"], places["y"], places["z"])
    return gpd.GeoDataFrame(
        {
            "id": [f"s{number + 1}" for number in range(len(rows))],
            "kind": layout.choices["sensor"].iloc[rows].tolist(),
            "candidate": layout.choices["candidate"].iloc[rows].tolist(),
            "height_m": places["height_m"].to_numpy(np.float64).round(3),
            "yaw_deg": places["yaw_deg"].to_numpy(np.float64).round(3),
        },
        geometry=points,
    )


def _plan_text(site: SiteFolder, plan: str, table: str, sensors: int) -> str:
    """A plan of exactly those sensors: as many as stand, and all of them mandatory."""
    if not sensors:
        raise InputError("no sensor stands", where=f"plan {plan}", hint="let one stand first")
    base = site.resolved.plans[plan]
    body = PlanBody(
        title=f"{base.title}, as drawn",
        sensors=base.sensors,
        base=plan,
        at_least=base.at_least,
        goal="sensors",
        amount=sensors,
    )
    value, dropped = plan_value(site, body, {"mandatory": table})
    content = {"placement": {"own_plans": {f"{plan}-as-drawn": value}}}
    head = f"# Into the site file; {table} beside it.\n" + (f"# {dropped}\n" if dropped else "")
    return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
