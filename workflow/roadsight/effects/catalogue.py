"""The effects that can be simulated, and which of them are at a site.

Each has a quantity and the threshold that decides on it.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from roadsight.base.errors import InputError, nearest
from roadsight.base.section import Section, validated
from roadsight.base.texts import read_yaml
from roadsight.effects.quantities import PLACEMENT, POLES, Circumstances, occurrences

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


@dataclass(frozen=True)
class Decision:
    """One effect at one site; the fields of ``effects.json``.

    Parameters
    ----------
    quantity, value, unit, threshold : what decided.
    expected_change : share of the answer that simulating it changes, estimated.
    expected_seconds : processor time of simulating it, estimated.
    """

    effect: str
    job: str
    decision: Literal["simulate", "skip"]
    quantity: str
    value: float
    unit: str
    threshold: float
    reason: str
    expected_change: float
    expected_seconds: float


def plan(
    effects: Mapping[str, Effect],
    modes: Mapping[str, str],
    jobs: Collection[str],
    circumstances: Circumstances,
) -> list[Decision]:
    """Decide on every effect of the jobs that a site asks for.

    Parameters
    ----------
    effects : the catalogue. modes : of the effects that the site decides itself.
    """
    return [
        decide(name, effect, modes.get(name, effect.mode), circumstances)
        for name, effect in effects.items()
        if effect.job in jobs
    ]


def decide(name: str, effect: Effect, mode: str, circumstances: Circumstances) -> Decision:
    """Decide on one effect; a mode other than auto decides it, but the quantity is told as well."""
    measured = QUANTITIES[effect.job][name](circumstances)
    above = measured.value > effect.threshold
    simulated = above if mode == "auto" else mode == "simulate"
    unit = f" {effect.unit}" if effect.unit else ""
    side = "above" if above else "not above"
    told = f"{effect.quantity} {measured.value:.3g}{unit} is {side} {effect.threshold:g}{unit}"
    if measured.remark:
        told = f"{told}: {measured.remark}"
    return Decision(
        effect=name,
        job=effect.job,
        decision="simulate" if simulated else "skip",
        quantity=effect.quantity,
        value=measured.value,
        unit=effect.unit,
        threshold=effect.threshold,
        reason=told if mode == "auto" else f"the site's settings say {mode}; {told}",
        expected_change=min(measured.value * effect.change_per_unit, 1.0),
        expected_seconds=effect.seconds * occurrences(effect.per, circumstances),
    )
