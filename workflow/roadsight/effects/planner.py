"""Decisions on effects."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

from roadsight.effects.catalogue import QUANTITIES, Effect
from roadsight.effects.circumstances import Circumstances, Quantity, occurrences


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
    return Decision(
        effect=name,
        job=effect.job,
        decision="simulate" if simulated else "skip",
        quantity=effect.quantity,
        value=measured.value,
        unit=effect.unit,
        threshold=effect.threshold,
        reason=_reason(effect, mode, measured, above),
        expected_change=min(measured.value * effect.change_per_unit, 1.0),
        expected_seconds=effect.seconds * occurrences(effect.per, circumstances),
    )


def _reason(effect: Effect, mode: str, measured: Quantity, above: bool) -> str:
    unit = f" {effect.unit}" if effect.unit else ""
    side = "above" if above else "not above"
    found = f"{effect.quantity} {measured.value:.3g}{unit} is {side} {effect.threshold:g}{unit}"
    told = f"{found}: {measured.remark}" if measured.remark else found
    return told if mode == "auto" else f"the site's settings say {mode}; {told}"
