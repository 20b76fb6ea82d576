"""The process between the studio and Snakemake: it outlives the studio and says how a run ended.

``python -m roadsight.studio.runner FOLDER ORDER COMMAND...``, ORDER as JSON, leads a session of
its own, so that one signal reaches Snakemake and its steps as Ctrl-C in a terminal does. It holds a
lock on ``FOLDER/lock`` while it lives, which is how a later studio knows; only the holder writes
what the files of ``FOLDER`` say of a run.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, BinaryIO

from roadsight.io.records.atomic import write_json

# Files of a run in its folder.
LOCK = "lock"
ORDER = "order.json"
BEGUN = "begun.json"
ENDED = "ended.json"
EVENTS = "events.jsonl"
OUTPUT = "output.log"
GRACE_S = 20.0  # How long a run may take to stop before it is told more firmly
BUSY = 3  # Exit code: another run holds the lock
# How often the lock is tried: the studio holds it for moments, to see whether a run is alive
_TRIES = 20
_PAUSE_S = 0.1  # Between two tries


def hold(folder: Path, tries: int = 1) -> BinaryIO | None:
    """The lock as an open file, or None if another process has it."""
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / LOCK).open("ab")
    for attempt in range(tries):
        if attempt:
            time.sleep(_PAUSE_S)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except OSError:
            continue
    file.close()
    return None


def is_held(folder: Path) -> bool:
    """Whether a run holds the lock; two that ask at once do not see each other."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        return False


class Watch:
    """One run of a command.

    Parameters
    ----------
    grace_s : time to stop.
    """

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self.grace_s = grace_s
        self.asked_s: float | None = None
        self.stopped = False
        # Before the command starts: it then gets these signals even where they were ignored.
        for kind in (signal.SIGINT, signal.SIGTERM):
            signal.signal(kind, self.asked)

    def asked(self, *_: Any) -> None:
        """Somebody stops the run; the command has got the same signal."""
        self.stopped = True
        if self.asked_s is None:
            self.asked_s = time.monotonic()

    def wait(self, process: subprocess.Popen[bytes]) -> int:
        """Exit code of a process of this group; one that does not stop in time gets SIGTERM."""
        while True:
            try:
                return process.wait(timeout=0.5)
            except subprocess.TimeoutExpired:
                late = self.asked_s is not None and time.monotonic() > self.asked_s + self.grace_s
                if late:
                    self.asked_s = time.monotonic()
                    os.killpg(os.getpgid(0), signal.SIGTERM)


def main(arguments: list[str]) -> int:
    """Run the command and write what becomes of it."""
    folder, order, command = Path(arguments[0]), arguments[1], arguments[2:]
    lock = hold(folder, _TRIES)
    if lock is None:
        return BUSY
    for name in (BEGUN, ENDED, EVENTS, OUTPUT):
        (folder / name).unlink(missing_ok=True)
    write_json(folder / ORDER, json.loads(order))
    with (folder / OUTPUT).open("wb") as output:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(output.fileno(), stream.fileno())
    watch = Watch()
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    write_json(folder / BEGUN, {"pid": os.getpid(), "time": time.time()})
    code = watch.wait(process)
    ended = {"code": code, "stopped": watch.stopped, "time": time.time()}
    write_json(folder / ENDED, ended)
    lock.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
