"""What an answer rests on, compared with what it needs: notes, doubts and refusals.

A stage that measures something its answer hangs on says so with a `Doubt`. Notes and doubts travel
beside the answer to the summary, the report's first screen and the log; a refusal ends the run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from roadsight.base.errors import InputError

Severity = Literal["note", "doubt", "refused"]

Value = float | str | None


@dataclass(frozen=True)
class Doubt:
    """One thing that limits what an answer is worth.

    Parameters
    ----------
    code : stable name for programs, such as ``pavement_fragments``.
    severity : note (an assumption to know), doubt (the answer may be wrong), refused (not fit).
    message : one sentence for people, with what to do where something can be done.
    measured, limit : what was found, and what the answer needs.
    """

    code: str
    severity: Severity
    message: str
    measured: Value = None
    limit: Value = None

    def to_dict(self) -> dict[str, Any]:
        """As it is written in ``summary.json``."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Doubt:
        """As `to_dict` wrote it."""
        return cls(**content)


def refuse(doubts: Iterable[Doubt], where: str) -> None:
    """End the run where one of the doubts is a refusal.

    Raises
    ------
    InputError : with the first refusal's message, the value measured and the limit.
    """
    for doubt in doubts:
        if doubt.severity == "refused":
            raise InputError(doubt.message, where=where, found=doubt.measured, allowed=doubt.limit)


_LISTED = 3
"""Names that a sentence can hold."""


def listed(names: Sequence[str]) -> str:
    """Names for a message, each once: the first few, and how many more there are."""
    once = list(dict.fromkeys(names))
    more = f" and {len(once) - _LISTED} more" if len(once) > _LISTED else ""
    return ", ".join(once[:_LISTED]) + more


_RANK = {"refused": 0, "doubt": 1, "note": 2}


def by_severity(doubts: Iterable[Doubt]) -> list[Doubt]:
    """Gravest first, otherwise in their order; the same doubt is said once."""
    return sorted(dict.fromkeys(doubts), key=lambda doubt: _RANK[doubt.severity])
