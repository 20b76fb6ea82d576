"""Plans of one site, kept in its site file (`placement.own_plans`) with their places beside it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
import yaml
from pydantic import Field, TypeAdapter

from roadsight.base.errors import InputError
from roadsight.base.section import Count, Name
from roadsight.config.plans import FILES, Budget, Money, Plan, PlanOptions, load_plans
from roadsight.io.vector.vectors import read_polygons, write_geojson
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.studio.layout import Layout, WhatIf
from roadsight.studio.project import Project, SiteFolder
from roadsight.studio.requests import Body, field_of
from roadsight.studio.site_files import (
    Writer,
    saving,
    site_version,
    with_value,
    write_site,
    write_table,
)

_SECTION, _KEY = "placement", "own_plans"
# Files of places that the studio writes, named after their plan
_PLACES = {"mandatory": "mandatory.csv", "forbidden": "forbidden.geojson"}
# What a plan may have beside options
_ANY_PLAN = set(Plan.model_fields) - set(PlanOptions.model_fields)


def about_plans(project: Project, site: SiteFolder) -> dict[str, Any]:
    """Sensors that plans may use, and the plans of a site as the editor shows them."""
    kinds = load_sensors(project.config().sensors_file)
    own = site.resolved.site.placement.own_plans
    described = []
    for name, plan in (site.resolved.plans | own).items():
        goal, amount = _goal(plan)
        described.append(
            {
                "name": name,
                "title": plan.title,
                "sensors": plan.sensors,
                "at_least": plan.at_least,
                "goal": goal,
                "amount": amount,
                **{option: plan.file_of(option) is not None for option in _PLACES},
                "own": name in own,
            }
        )
    return {
        "version": site_version(site, "plans"),
        "sensors": [{"name": name, "cost": kind.cost} for name, kind in kinds.items()],
        "fields": {
            "name": TypeAdapter(Name).json_schema(),
            "title": field_of(Plan, "title") | field_of(PlanBody, "title"),
            "at_least": field_of(PlanOptions, "at_least"),
            "sensors": field_of(Budget, "sensors"),
            "cost": field_of(Budget, "cost"),
            "price": field_of(PlanOptions, "price"),
        },
        "plans": described,
    }


def _goal(plan: Plan) -> tuple[str, float | None]:
    if plan.price is not None:
        return "price", plan.price
    if plan.budget is None:
        return "cover", None
    if plan.budget.sensors is not None:
        return "sensors", plan.budget.sensors
    return "cost", plan.budget.cost


def save_plan(
    project: Project, stem: str, name: str, body: PlanBody, version: str | None = None
) -> tuple[list[str], str]:
    """Write a plan into the site file, its places beside it.

    Parameters
    ----------
    version : as `saving`.

    Returns
    -------
    files that changed, relative to the project; and what the base asks for and this plan cannot, in
    a sentence, or ""

    Raises
    ------
    InputError : the name is taken, anything is wrong in the plan, or the site file cannot be
        changed; nothing is written then.
    """
    with saving(project, stem, "plans", version) as site:
        before = site.resolved.site.placement.own_plans.get(name)
        config, is_taken = project.config(), before is not None and not body.replace
        if is_taken or name in load_plans(config.plans_file, config.sensors_file):
            raise InputError(
                "is the name of a plan already", where="plan", found=name, hint="choose another one"
            )
        _check_places(body.mandatory or [], body.sensors)
        files: dict[str, Writer] = {}  # how to write the places that are given
        if body.mandatory:
            files["mandatory"] = partial(write_standing, places=body.mandatory)
        if body.forbidden:
            squares = _barred_squares(site, body.base, body.forbidden)
            files["forbidden"] = partial(write_geojson, features=squares, frame=site.frame())
        named = {part: f"{stem}/{name}.{_PLACES[part]}" for part in files}
        value, dropped = plan_value(site, body, named)
        if before is not None and before.on_request:
            value["on_request"] = True
        text = project.inside(site.resolved.file).read_bytes().decode()
        text = with_value(text, _KEY, name, value, within=_SECTION)
        own = {Path(file) for part in _PLACES if (file := _file(site, name, part)) and before}
        beside = {f"{name}.{_PLACES[part]}": write for part, write in files.items()}
        changed = write_site(project, site, text, beside, {project.inside(path) for path in own})
        _remove_unnamed(project, site, name)
        return changed, dropped


def _remove_unnamed(project: Project, site: SiteFolder, name: str) -> None:
    """Remove the places that the studio wrote for a plan and that no plan names any more.

    Parameters
    ----------
    site : as it was before; the plan that it has there had named them.
    """
    now = project.site(site.stem).resolved
    own, others = now.site.placement.own_plans.values(), now.plans.values()
    files = {now.beside(plan.file_of(option)) for plan in own for option in FILES}
    files |= {plan.file_of(option) for plan in others for option in FILES}
    named = {Path(file).resolve() for file in files if file}
    for part, kind in _PLACES.items():
        path = project.inside(site.resolved.file.parent / site.stem / f"{name}.{kind}")
        file = _file(site, name, part)
        if file and project.inside(file) == path and path not in named:
            path.unlink(missing_ok=True)


def _file(site: SiteFolder, name: str, part: str) -> str | None:
    """File of places that the site's own plan names."""
    plan = site.resolved.site.placement.own_plans.get(name)
    return site.resolved.beside(plan.file_of(part)) if plan else None


def _check_places(places: Sequence[Standing], sensors: Sequence[str]) -> None:
    for number, place in enumerate(places, start=1):
        if place.kind not in sensors and (place.kind or len(sensors) > 1):
            raise InputError(
                "names no sensor of the plan",
                where=f"mandatory place {number}",
                found=place.kind or "nothing",
                allowed=", ".join(sensors),
            )
    known = [(round(place.x, 2), round(place.y, 2)) for place in places]
    twice = next((number for number, at in enumerate(known) if at in known[:number]), None)
    if twice is not None:
        raise InputError(
            "stands at the place of another, and a plan has one sensor a place",
            where=f"mandatory place {twice + 1}",
            hint="move one of them",
        )


def _barred_squares(
    site: SiteFolder, base: str | None, spots: Sequence[Barred]
) -> gpd.GeoDataFrame:
    """Squares around spots, and the polygons that the base forbids already."""
    frame = site.frame()
    middles = frame.to_local([[spot.x, spot.y, frame.origin[2]] for spot in spots])[:, :2]
    boxes = [
        shapely.box(x - spot.half_m, y - spot.half_m, x + spot.half_m, y + spot.half_m)
        for (x, y), spot in zip(middles.tolist(), spots, strict=True)
    ]
    names = [f"left{number + 1}" for number in range(len(boxes))]
    squares = gpd.GeoDataFrame({"name": names}, geometry=boxes)
    own = site.resolved.site.placement.own_plans
    plan = own.get(base or "") or site.resolved.plans.get(base or "")
    if plan is None or plan.forbidden is None:
        return squares
    file = plan.forbidden.file
    path = site.resolved.layered(file) if base in own else file
    before = read_polygons(path, frame, plan.forbidden.crs)
    names = [f"before{number + 1}" for number in range(len(before))]
    kept = gpd.GeoDataFrame({"name": names}, geometry=before.geometry.to_numpy())
    return pd.concat([kept, squares], ignore_index=True)


def write_standing(path: Path, places: Sequence[Standing]) -> None:
    """Places of sensors as a table that a plan's ``mandatory`` reads."""
    rows = [["id", "kind", "x", "y", "height_m", "candidate"]]
    for number, place in enumerate(places, start=1):
        height = "" if place.height_m is None else f"{place.height_m:g}"
        at = (f"{place.x:.3f}", f"{place.y:.3f}", height)
        rows.append([f"s{number}", place.kind, *at, place.candidate])
    write_table(path, rows)


def plan_value(
    site: SiteFolder, body: PlanBody, files: dict[str, str]
) -> tuple[dict[str, Any], str]:
    """The plan as the site file holds it; and what had to be left out of the base, in a sentence.

    Parameters
    ----------
    files : of the places that are given, as the site file names them.

    Raises
    ------
    InputError : no such base, or an amount is missing.
    """
    value: dict[str, Any] = {"title": body.title, "sensors": body.sensors}
    value |= _further(site, body)
    for part in _PLACES:
        if getattr(body, part) is not None:
            value.pop(part, None)
    value |= {part: {"file": file} for part, file in files.items()}
    if body.at_least is not None:
        value["at_least"] = body.at_least
    value |= _aim(body)
    if "availability" not in value or not value.keys() - _ANY_PLAN:
        return value, ""
    level = value.pop("availability")
    return value, (
        f"availability: {level:g} of the plan {body.base} is left out, since it goes with no place,"
        " budget or other option."
    )


def _aim(body: PlanBody) -> dict[str, Any]:
    if body.goal == "cover":
        return {}
    if not body.amount:
        raise InputError("needs an amount above zero", where=f"goal {body.goal}")
    if body.goal == "sensors" and body.amount % 1:
        raise InputError("is no whole number", where=f"goal {body.goal}", found=body.amount)
    if body.goal == "price":
        return {"price": body.amount}
    if body.goal == "cost":
        return {"budget": {"cost": body.amount}}
    return {"budget": {"sensors": int(body.amount)}}


def _further(site: SiteFolder, body: PlanBody) -> dict[str, Any]:
    """Options of the base that the editor does not show."""
    if body.base is None:
        return {}
    own = site.resolved.site.placement.own_plans
    if body.base not in own and body.base not in site.resolved.plans:
        raise InputError("no such plan", where=f"site {site.stem}", found=body.base)
    plan = own.get(body.base)
    if plan is None:
        folder = site.resolved.file.parent
        plan = site.resolved.plans[body.base].located(lambda path: os.path.relpath(path, folder))
    shown = {"title", "sensors", "at_least", "budget", "price", "on_request"}
    options = plan.model_dump(exclude=shown, exclude_defaults=True)
    for name, option in options.items():
        if isinstance(option, dict):
            options[name] = {key: value for key, value in option.items() if value is not None}
    return options


def remove_plan(project: Project, stem: str, name: str, version: str | None = None) -> list[str]:
    """Take a site's own plan out of its file, with the places that the studio wrote for it.

    Parameters
    ----------
    version : as `saving`.

    Raises
    ------
    InputError : it is no plan of the site alone, or the site file cannot be changed.
    """
    with saving(project, stem, "plans", version) as site:
        if name not in site.resolved.site.placement.own_plans:
            raise InputError("is no plan of this site alone", where="plan", found=name)
        text = project.inside(site.resolved.file).read_bytes().decode()
        changed = with_value(text, _KEY, name, None, within=_SECTION)
        done = write_site(project, site, changed, {}, set())
        _remove_unnamed(project, site, name)
        return done


# A plan as the page sends it.

_MOST = 5000  # Places of a plan that are taken from a page
_Native = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
_Text = Annotated[str, Field(max_length=200)]


class Standing(Body):
    """A place where a sensor stands for certain: x, y in the site's CRS and units.

    Parameters
    ----------
    kind : its sensor; "" where the plan has one. height_m : above ground; None: any.
    candidate : the candidate in the pose that is meant; "": the pose that sees most.
    """

    x: _Native
    y: _Native
    kind: _Text = ""
    height_m: Annotated[float, Field(ge=0, le=100)] | None = None
    candidate: _Text = ""


class Barred(Body):
    """A square in which no sensor stands: its middle in the site's CRS and units, half its side."""

    x: _Native
    y: _Native
    half_m: Annotated[float, Field(gt=0, le=1e5)]


class PlanBody(Body):
    """A plan that is to be saved.

    Parameters
    ----------
    base : plan whose further options stay. replace : whether a plan of that name may be there.
    goal, amount : cover everything; or see most with so many sensors or so much cost; or the cost
        of leaving a target unseen. mandatory, forbidden : places; None keeps those of the base, and
        forbidden ones are added to them.
    """

    title: Annotated[str, Field(min_length=1, max_length=200)]
    sensors: Annotated[list[_Text], Field(min_length=1, max_length=200)]
    at_least: Count | None = None
    goal: Literal["cover", "sensors", "cost", "price"] = "cover"
    amount: Money | None = None
    mandatory: Annotated[list[Standing], Field(max_length=_MOST)] | None = None
    forbidden: Annotated[list[Barred], Field(max_length=_MOST)] | None = None
    base: _Text | None = None
    replace: bool = False


# Sensors of a what-if, and the plan that asks for them, as files to take away.

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
