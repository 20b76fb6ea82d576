"""The effects that can be simulated, each with the quantity and the threshold that decide."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Literal

from pydantic import Field

from roadsight.base.errors import InputError, nearest
from roadsight.base.section import Section, validated
from roadsight.base.texts import read_yaml
from roadsight.effects.quantities import PLACEMENT, POLES

Mode = Literal["auto", "simulate", "skip"]
Job = Literal["placement", "poles"]
# How each effect's quantity is measured, by job.
QUANTITIES = {"placement": PLACEMENT, "poles": POLES}


class Effect(Section):
    """One effect."""

    job: Job = Field(description="job that it belongs to")
    title: str = Field(description="name for people")
    quantity: str = Field(description="what is measured to decide")
    unit: str = Field(default="", description="unit of the quantity; empty: a plain number")
    threshold: float = Field(ge=0, description="simulated where the quantity exceeds this")
    tolerance: float = Field(
        gt=0, le=1, description="largest change of the answer allowed where it is skipped, share"
    )
    change_per_unit: float = Field(
        ge=0, description="change of the answer per unit of the quantity, share; from the audit"
    )
    seconds: float = Field(ge=0, description="processor time of simulating it once, s")
    per: Literal["site", "candidate", "map", "image"] = Field(
        default="site", description="what it is simulated once for; maps: candidates times sensors"
    )
    mode: Mode = Field(default="auto", description="auto, or decided whatever the scene is like")
    source: str = Field(description="where model and figures come from")


class Catalogue(Section):
    """The whole of ``config/effects.yaml``."""

    audit: list[str] = Field(default=[], description="sites on which decisions are audited")
    effects: dict[str, Effect] = Field(min_length=1, description="effects by name")


def load_catalogue(path: str | os.PathLike[str]) -> dict[str, Effect]:
    """Effects by name, in the order of the file.

    Raises
    ------
    InputError : malformed file, an effect that nothing measures, or one that is missing.
    """
    effects = validated(Catalogue, read_yaml(path), str(path)).effects
    for name, effect in effects.items():
        known = QUANTITIES[effect.job]
        if name not in known:
            raise InputError(
                f"unknown effect {name!r} of the job {effect.job}",
                where=str(path),
                hint=nearest(name, known),
            )
    missing = [name for known in QUANTITIES.values() for name in known if name not in effects]
    if missing:
        raise InputError(f"lacks the effect {missing[0]!r}", where=str(path))
    return effects


def load_audit_sites(path: str | os.PathLike[str]) -> list[str]:
    """Names of the sites on which decisions are audited.

    Raises
    ------
    InputError : malformed file.
    """
    return validated(Catalogue, read_yaml(path), str(path)).audit


def check_names(names: Iterable[str], effects: Mapping[str, Effect], where: str) -> None:
    """Refuse modes of effects that there are not.

    Raises
    ------
    InputError : for the first unknown name, with the nearest known one.
    """
    for name in names:
        if name not in effects:
            raise InputError(f"unknown effect {name!r}", where=where, hint=nearest(name, effects))
