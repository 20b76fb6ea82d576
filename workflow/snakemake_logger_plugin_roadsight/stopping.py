"""A stop is a stop: TERM ends a run, at whatever moment it comes.

Snakemake's scheduler takes its own lock in the handler of the signal. Python runs handlers in the
main thread, between any two instructions: where that thread holds the lock already, it waits for
itself for ever. Clusters send TERM before they take a machine away.
"""

from __future__ import annotations

import threading
from typing import Any

from snakemake.scheduling.job_scheduler import JobScheduler

from snakemake_logger_plugin_roadsight.patching import replace_method

_EXPECTED = """
def exit_gracefully(self, *args):
    with self._lock:
        self._user_kill = "graceful"
    self._open_jobs.release()
"""


def exit_gracefully(scheduler: Any, *_signal: Any) -> None:
    """Let running jobs end and start no others, as Snakemake's own handler does.

    To set a field needs no lock. The semaphore that wakes the scheduler has one, which the main
    thread may hold, too: another thread releases it.
    """
    scheduler._user_kill = "graceful"
    threading.Thread(target=scheduler._open_jobs.release, daemon=True).start()


def let_stops_through() -> None:
    """Give the scheduler a handler that takes no lock; call this before a run begins."""
    without = "a run that gets TERM may hang"
    replace_method(JobScheduler, "exit_gracefully", _EXPECTED, exit_gracefully, without)
