"""How stages tell what their answers rest on."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence

from roadsight.base.doubts import Doubt, by_severity, refuse
from roadsight.io.records.atomic import write_json

_LEVEL = {"note": logging.INFO, "doubt": logging.WARNING, "refused": logging.ERROR}


def tell(
    doubts: Sequence[Doubt], path: str | os.PathLike[str], where: str, log: logging.Logger
) -> None:
    """Log doubts and write them for the summary; a refusal ends the run and writes nothing.

    Raises
    ------
    InputError : one of them is a refusal.
    """
    ordered = by_severity(doubts)
    for doubt in ordered:
        beside = "" if doubt.limit is None else f" (limit {doubt.limit})"
        found = "" if doubt.measured is None else f": {doubt.measured}{beside}"
        log.log(_LEVEL[doubt.severity], "%s: %s%s", doubt.severity, doubt.message, found)
    refuse(ordered, where)
    write_json(path, [doubt.to_dict() for doubt in ordered])


def keep(doubts: Sequence[Doubt], path: str | os.PathLike[str]) -> None:
    """Write doubts that are logged already for the summary."""
    write_json(path, [doubt.to_dict() for doubt in by_severity(doubts)])
