"""The table of physical effects: which were simulated, which were skipped, and why."""

from __future__ import annotations

from typing import Any

from roadsight.report.wording import label, number, percent, seconds

_UNITS = {"deg": "°", "m2": " m²"}
"""Units as people write them, where plain text has others."""


def effect_rows(effects: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the table, simulated effects first, each group in the order of its names.

    Parameters
    ----------
    effects : ``effects`` of summary.json, decisions by name.
    """
    rows = [_row(name, about) for name, about in sorted(effects.items())]
    return sorted(rows, key=lambda row: not row["simulated"])


def _row(name: str, about: dict[str, Any]) -> dict[str, Any]:
    unit = _UNITS.get(about["unit"], f" {about['unit']}" if about["unit"] else "")
    quantity = str(about["quantity"])
    return {
        "effect": label(name),
        "job": about["job"],
        "simulated": about["decision"] == "simulate",
        "quantity": quantity[:1].upper() + quantity[1:],
        "value": f"{_figure(about['value'])}{unit}",
        "threshold": f"{_figure(about['threshold'])}{unit}",
        "reason": about["reason"],
        "change": percent(about["expected_change"]),
        "seconds": seconds(about["expected_seconds"]),
    }


def _figure(value: float) -> str:
    """Three digits that count."""
    return number(float(f"{value:.3g}"))
