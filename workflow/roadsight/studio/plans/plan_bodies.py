"""A plan as the page sends it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from roadsight.base.section import Count
from roadsight.config.plan_options import Money

_MOST = 5000
"""Places of a plan that are taken from a page."""
_Native = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
_Text = Annotated[str, Field(max_length=200)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Standing(_Body):
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


class Barred(_Body):
    """A square in which no sensor stands: its middle in the site's CRS and units, half its side."""

    x: _Native
    y: _Native
    half_m: Annotated[float, Field(gt=0, le=1e5)]


class PlanBody(_Body):
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
