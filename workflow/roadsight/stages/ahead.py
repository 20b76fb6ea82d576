"""Items worked on in other threads while the results before them are used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int
) -> Iterator[Result]:
    """Results of ``work`` in the order of the items, whatever the number of threads.

    The caller's thread takes the items and uses the results; the others work, at most one item each
    and one more ahead. With one thread in all, each result is made when it is asked for.

    Parameters
    ----------
    threads : in all, at least 1; ``work`` runs in parallel only where it releases the GIL.
    """
    if threads < 2:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(threads - 1) as pool:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
