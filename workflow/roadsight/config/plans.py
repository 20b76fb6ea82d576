"""Deployment plans: which sensors may be placed together (paper 1, section 3.2)."""

from __future__ import annotations

from pydantic import Field, model_validator

from roadsight.base.errors import InputError, nearest
from roadsight.base.section import Name, Section
from roadsight.base.texts import read_yaml
from roadsight.base.validation import validated
from roadsight.config.plan_options import PlanOptions


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
    known = _sensor_names(sensors_file)
    for name, plan in plans.items():
        for sensor in plan.sensors:
            if sensor not in known:
                raise InputError(
                    f"plan {name!r} names the unknown sensor {sensor!r}",
                    where=where,
                    hint=f"{nearest(sensor, known)} (sensors are defined in {sensors_file})",
                )


def _sensor_names(sensors_file: str) -> list[str]:
    content = read_yaml(sensors_file)
    sensors = content.get("sensors") if isinstance(content, dict) else None
    if not isinstance(sensors, dict):
        raise InputError("lacks the mapping 'sensors' of names to definitions", where=sensors_file)
    return [str(name) for name in sensors]
