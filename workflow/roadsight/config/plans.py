"""Deployment plans: which sensors may be placed together (paper 1, section 3.2)."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from roadsight.base.errors import InputError, nearest
from roadsight.base.section import Count, Metres, Name, Section, validated
from roadsight.base.texts import read_yaml

FILES = ("areas", "forbidden", "mandatory", "poles")  # options that name a file
Money = Annotated[float, Field(ge=0, le=1e12)]


class Budget(Section):
    """What may be spent: see as much as possible for it."""

    sensors: Count | None = Field(
        default=None, description="see the most with at most so many sensors"
    )
    cost: Money | None = Field(
        default=None, description="see the most for so much, in the sensors' unit of cost"
    )

    @model_validator(mode="after")
    def _one_way(self) -> Budget:
        if (self.sensors is None) == (self.cost is None):
            raise ValueError("give either sensors or cost, not both or neither")
        return self


class Features(Section):
    """A vector file of the user."""

    file: str = Field(description="GeoJSON, GeoPackage or another vector file; points also as CSV")
    crs: str | None = Field(default=None, description="its CRS if the file names none")


class Mandatory(Features):
    """Points where sensors stand for certain."""

    within_m: Metres = Field(default=3.0, description="how near a candidate must lie, m")


class Poles(Features):
    """Poles that stand already and carry sensors for less."""

    within_m: Metres = Field(default=1.5, description="how near a pole a candidate must lie, m")
    cost: Money = Field(default=0.0, description="cost of mounting on a pole that states none")
    new_cost: Money = Field(default=1.0, description="cost of mounting anywhere else")


class PlanOptions(Section):
    """Options of a plan; without any it is the cheapest cover."""

    at_least: Count | None = Field(
        default=None, description="sensors that must see each target, instead of cover.at_least"
    )
    budget: Budget | None = Field(default=None, description="see the most for so much")
    price: float | None = Field(
        default=None, gt=0, le=1e12, description="cost of leaving a target of weight 1 unseen"
    )
    areas: Features | None = Field(
        default=None, description="polygons with weight and at_least of the targets inside"
    )
    forbidden: Features | None = Field(default=None, description="polygons without sensors")
    mandatory: Mandatory | None = Field(default=None, description="points of certain sensors")
    poles: Poles | None = Field(default=None, description="points of poles that stand already")
    spacing_m: Metres | None = Field(default=None, description="least distance of sensors, m")
    keep_share: float | None = Field(
        default=None, gt=0, le=1, description="share of the coverage that any one failure leaves"
    )
    curve: int | None = Field(
        default=None, ge=2, le=200, description="points of a curve of coverage against cost"
    )
    robust: Literal["tolerance"] | None = Field(
        default=None, description="tolerance: what a sensor counts for, it sees as it may stand"
    )
    alternatives: bool = Field(
        default=False, description="say which positions are interchangeable, how unique the answer"
    )

    @model_validator(mode="after")
    def _sensible(self) -> PlanOptions:
        if self.budget is not None and self.price is not None:
            raise ValueError(
                "budget and price exclude each other: a budget says what may be spent, a price"
                " what seeing is worth; leave one out"
            )
        if self.price is not None and self.curve is not None:
            raise ValueError(
                "curve and price exclude each other: the curve shows what every budget buys;"
                " leave price out"
            )
        return self

    def options(self) -> str:
        """The options that are set as JSON, files left out; empty where there are none."""
        chosen: dict[str, Any] = {
            name: value
            for name, value in self.model_dump(include=set(PlanOptions.model_fields)).items()
            if value not in (None, False)
        }
        for name in FILES:
            chosen.get(name, {}).pop("file", None)
        return json.dumps(chosen, sort_keys=True) if chosen else ""

    def file_of(self, name: str) -> str | None:
        """File that an option names."""
        features: Features | None = getattr(self, name)
        return None if features is None else features.file

    def located(self, place: Callable[[str], str]) -> Self:
        """The same with other paths of files."""
        changes = {
            name: features.model_copy(update={"file": place(features.file)})
            for name in FILES
            if (features := getattr(self, name)) is not None
        }
        return self.model_copy(update=changes)


class Plan(PlanOptions):
    """One deployment plan."""

    title: str = Field(description="name for people")
    sensors: list[str] = Field(min_length=1, description="names of sensors that may be placed")
    availability: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="share of the time in which sensors together see each target past traffic",
    )
    on_request: bool = Field(
        default=False, description="solved only where it is asked for by its name"
    )

    @model_validator(mode="after")
    def _one_aim(self) -> Plan:
        if self.availability is not None and self.options():
            raise ValueError(
                "availability goes with no other option of a plan: it says how often each target is"
                " seen, the others count sensors; make two plans of it"
            )
        return self


class Plans(Section):
    """The whole of ``config/plans.yaml``."""

    plans: dict[Name, Plan] = Field(min_length=1, description="plans by name")


def load_plans(plans_file: str, sensors_file: str) -> dict[str, Plan]:
    """Read the plans and check that their sensors exist.

    Raises
    ------
    InputError : an unknown sensor, a plan without sensors, or a malformed file.
    """
    plans = validated(Plans, read_yaml(plans_file), plans_file).plans
    check_sensors(plans, sensors_file, plans_file)
    return plans


def check_sensors(plans: dict[str, Plan], sensors_file: str, where: str) -> None:
    """Check that the sensors of plans exist.

    Raises
    ------
    InputError : one does not.
    """
    content = read_yaml(sensors_file)
    sensors = content.get("sensors") if isinstance(content, dict) else None
    if not isinstance(sensors, dict):
        raise InputError("lacks the mapping 'sensors' of names to definitions", where=sensors_file)
    known = [str(name) for name in sensors]
    for name, plan in plans.items():
        for sensor in plan.sensors:
            if sensor not in known:
                raise InputError(
                    f"plan {name!r} names the unknown sensor {sensor!r}",
                    where=where,
                    hint=f"{nearest(sensor, known)} (sensors are defined in {sensors_file})",
                )
