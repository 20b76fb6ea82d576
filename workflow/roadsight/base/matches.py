"""Lists of a user that are about something: how many of them meet it, and none is an error."""

from __future__ import annotations

import logging

from roadsight.base.errors import InputError

_FEW = 0.5
"""Share below which matches are told as a warning: more than half of a list about something else
is no accident."""


def tell_matches(
    log: logging.Logger, what: str, matched: int, total: int, where: str, hint: str = ""
) -> None:
    """Say how many of a list match.

    Parameters
    ----------
    what : what is listed, plural, and what it has to meet.

    Raises
    ------
    InputError : the list is not empty and none matches.
    """
    if total and not matched:
        raise InputError(
            f"none of {total} {what}", where=where, hint=hint or "check names, place and CRS"
        )
    level = logging.WARNING if matched < _FEW * total else logging.INFO
    log.log(level, "%d of %d %s: %s", matched, total, what, where)
