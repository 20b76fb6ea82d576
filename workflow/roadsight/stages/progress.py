"""Progress of long loops in the log."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")
_SECONDS = 5.0
"""Least time between two lines of the log."""


def logged(items: Iterable[Item], total: int, log: logging.Logger, what: str) -> Iterator[Item]:
    """Pass items on; every few seconds say how many are done and how long the rest will take.

    Parameters
    ----------
    total : number of items. what : their name in the plural.
    """
    start = last = time.monotonic()
    for done, item in enumerate(items, start=1):
        yield item
        now = time.monotonic()
        if now - last >= _SECONDS or done == total:
            last = now
            left_s = (now - start) / done * (total - done)
            log.info("%d of %d %s, %.0f s left", done, total, what, left_s)
