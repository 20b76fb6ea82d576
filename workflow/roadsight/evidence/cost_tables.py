"""The fitted cost model as a JSON file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from roadsight.base.errors import InputError
from roadsight.evidence.cost_records import read_amounts, read_records, read_stored
from roadsight.evidence.costs import (
    STORED,
    Line,
    StepCost,
    costs_from_content,
    costs_to_content,
    fit,
    fit_line,
    held_out,
    typical_factor,
)
from roadsight.io.records.atomic import read_json, write_json

SHIPPED = Path(__file__).resolve().parents[3] / "resources/costs/costs.json"


@dataclass(frozen=True)
class CostTable:
    """Everything that an estimate rests on.

    Parameters
    ----------
    steps : cost of each step. stored : bytes of each kind of result. dag : seconds and MiB of a
        dry run by the number of jobs. factor : within which two thirds of held-out sites lie.
    """

    steps: dict[str, StepCost]
    stored: dict[str, Line]
    dag: tuple[Line, Line]
    factor: float


def read_costs(path: Path) -> CostTable:
    """Read a cost model.

    Raises
    ------
    InputError : the file is missing or no cost model.
    """
    content = read_json(path)
    try:
        dag = Line(**content["dag"]["s"]), Line(**content["dag"]["mib"])
        stored = {kind: Line(**line) for kind, line in content["stored"].items() if kind in STORED}
        factor = float(content["held_out"]["factor"] or "nan")
        return CostTable(costs_from_content(content["steps"]), stored, dag, factor)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"is no cost model ({type(error).__name__}: {error})",
            where=str(path),
            hint="write one with 'roadsight estimate --fit results/<site> ...'",
        ) from error


def fit_costs(sites: Sequence[Path], dag: tuple[Line, Line]) -> dict[str, Any]:
    """Content of a cost model fitted on finished sites, with its error on each one held out.

    Raises
    ------
    InputError : a folder holds no results, or none of them names a step.
    """
    records = [record for site in sites for record in read_records(site)]
    if not records:
        raise InputError("no benchmark files", where=", ".join(map(str, sites)))
    amounts = {site.name: read_amounts(site) for site in sites}
    stored = {site.name: read_stored(site) for site in sites}
    ratios = held_out(records)
    return {
        "sites": {name: asdict(found) for name, found in amounts.items()},
        "steps": costs_to_content(fit(records)),
        "stored": {kind: asdict(line) for kind, line in _fit_stored(amounts, stored).items()},
        "dag": {"s": asdict(dag[0]), "mib": asdict(dag[1])},
        "held_out": {"predicted_by_actual": ratios, "factor": typical_factor(ratios.values())},
    }


def _fit_stored(amounts: dict[str, Any], stored: dict[str, dict[str, int]]) -> dict[str, Line]:
    """Bytes of each kind of result, from the sites that have any."""
    lines = {}
    for kind, step in STORED.items():
        sites = [name for name in amounts if stored[name][kind] > 0]
        if sites:
            units = [amounts[name].units(step.driver) for name in sites]
            lines[kind] = fit_line([1.0] * len(sites), units, [stored[s][kind] for s in sites])
    return lines


def write_costs(path: Path, content: dict[str, Any]) -> None:
    """Write a cost model; an error that cannot be told (no other site to hold out) is null."""
    held = content["held_out"]
    factor = held["factor"] if math.isfinite(held["factor"]) else None
    write_json(path, content | {"held_out": held | {"factor": factor}})
