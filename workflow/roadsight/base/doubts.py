"""What an answer rests on, compared with what it needs: notes, doubts and refusals.

A stage that measures something its answer hangs on says so with a `Doubt`. Notes and doubts travel
beside the answer to the summary, the report's first screen and the log; a refusal ends the run.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence, Set
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


_LISTED = 3  # names that a sentence can hold


def listed(names: Sequence[str]) -> str:
    """Names for a message, each once: the first few, and how many more there are."""
    once = list(dict.fromkeys(names))
    more = f" and {len(once) - _LISTED} more" if len(once) > _LISTED else ""
    return ", ".join(once[:_LISTED]) + more


_RANK = {"refused": 0, "doubt": 1, "note": 2}


def by_severity(doubts: Iterable[Doubt]) -> list[Doubt]:
    """Gravest first, otherwise in their order; the same doubt is said once."""
    return sorted(dict.fromkeys(doubts), key=lambda doubt: _RANK[doubt.severity])


# Share below which matches are told as a warning. A list that is about a site misses it by a few
# entries at its ends; one in five is another thing: of the sites under config/ all lists match as a
# whole. A list of a whole county gets the warning, which then says what it covers.
FEW = 0.8


def tell_matches(
    log: logging.Logger, what: str, matched: int, total: int, where: str, hint: str = ""
) -> list[Doubt]:
    """Say how many of a user's list match; none is an error.

    Parameters
    ----------
    what : what is listed, plural, and what it has to meet. hint : what would help the others.

    Returns
    -------
    a doubt where few match, for the summary; it is logged already

    Raises
    ------
    InputError : the list is not empty and none matches.
    """
    if total and not matched:
        raise InputError(
            f"none of {total} {what}", where=where, hint=hint or "check names, place and CRS"
        )
    text = f"{matched} of {total} {what}: {where}"
    if matched >= FEW * total:
        log.info("%s", text)
        return []
    text = f"{text}; {hint}" if hint else text
    log.warning("only %s", text)
    return [Doubt("few_matches", "doubt", f"only {text}", round(matched / total, 3), FEW)]


def tell_named(
    log: logging.Logger, what: str, named: Set[str], known: Set[str], where: str
) -> list[Doubt]:
    """Say how many names of a list are known, such as those of a videolog's images.

    A list of more than what is known is none of few, if it has most of what is known: a table of
    cameras may hold all images where every fifth one is used.

    Raises
    ------
    InputError : as `tell_matches`; the hint shows a name of either side.
    """
    matched = len(named & known)
    if matched and matched >= FEW * len(known):
        log.info("%d of %d known ones: %s: %s", matched, len(known), what, where)
        return []
    others = sorted(named - known)
    hint = f"such as {others[0]}" if others else ""
    if others and known and not matched:
        hint = f"it names {others[0]}, the videolog {min(known)}"
    return tell_matches(log, what, matched, len(named), where, hint)
