"""Lists of a user that are about something: how many of them meet it, and none is an error."""

from __future__ import annotations

import logging
from collections.abc import Set

from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError

FEW = 0.8
"""Share below which matches are told as a warning. A list that is about a site misses it by a few
entries at its ends; one in five is another thing: of the sites under config/ all lists match as a
whole. A list of a whole county gets the warning, which then says what it covers."""


def tell_matches(
    log: logging.Logger, what: str, matched: int, total: int, where: str, hint: str = ""
) -> list[Doubt]:
    """Say how many of a list match.

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
