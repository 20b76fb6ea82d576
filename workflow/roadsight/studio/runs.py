"""The workflow as the studio starts, watches and stops it: one run at a time.

Everything about a run is in files under ``.snakemake/roadsight/run``, written by the run itself
(`roadsight.studio.runner`), so that a studio that was ended and started again finds it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from statistics import mean
from typing import Any

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import read_json, write_json
from roadsight.studio.project import Project
from roadsight.studio.run_progress import (
    Job,
    Order,
    Progress,
    command,
    complaint,
    dry_run,
    environment,
    plan,
    progress_of,
    read_events,
    remaining,
    unlock,
)
from roadsight.studio.runner import BEGUN, BUSY, ENDED, EVENTS, ORDER, OUTPUT, is_held

FOLDER = ".snakemake/roadsight/run"
_START_S = 20.0  # How long the process of a run may take to lead it, before the studio answers
_LAST_STEPS = 8  # Finished steps that are shown
_LOG_BYTES = 64 << 10  # End of a log that is shown
_NO_RUN: dict[str, Any] = {"order": None}


class Runs:
    """Runs of one project's workflow."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._starting, self._planning = threading.Lock(), threading.Lock()

    @property
    def _folder(self) -> Path:
        return self._project.inside(FOLDER)

    def _is_alive(self) -> bool:
        """Whether a run of a studio holds the lock."""
        return is_held(self._folder)

    def plan(self, order: Order) -> dict[str, Any]:
        """What a run would do and why.

        Raises
        ------
        InputError : the workflow cannot be planned.
        """
        with self._planning:
            events = dry_run(self._project, order)
        found = plan(events, self._expected(order))
        return found | {"order": order.model_dump(), "cores": order.cores}

    def _expected(self, order: Order) -> dict[str, float]:
        asked = self._project.config().sites if order.site is None else [order.site]
        names = set()
        for stem in asked:
            # Snakemake itself tells what is wrong with a site.
            with suppress(InputError):
                names.add(self._project.site(stem).results.name)
        return earlier_seconds(self._project.root / "results", names)

    def start(self, order: Order) -> None:
        """Start the workflow.

        Raises
        ------
        InputError : it runs already, here or outside, or a lock was left behind.
        """
        with self._starting:
            self._check_free()
            folder = self._folder
            line = command(self._project, order, folder / EVENTS)
            expected = self._expected(order)
            about = order.model_dump() | {"time": time.time(), "expected_s": expected}
            self._launch(folder, json.dumps(about), line)

    def _check_free(self) -> None:
        if self._is_alive():
            raise _busy()
        outside = processes_outside(self._project.root)
        if outside:
            raise InputError(
                f"the workflow runs already, in process {outside[0]['pid']} outside the studio",
                where="studio",
                hint="wait for it, or stop it where it was started",
            )
        if lock_is_there(self._project.root):
            raise InputError(
                "a run that was killed has left its lock",
                where="studio",
                hint="remove the lock first",
            )

    def _launch(self, folder: Path, about: str, line: list[str]) -> None:
        # The files of the run belong to whoever holds its lock: until then it speaks into another.
        with tempfile.NamedTemporaryFile() as early:
            process = subprocess.Popen(
                [sys.executable, "-m", "roadsight.studio.runner", str(folder), about, *line],
                cwd=self._project.root,
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=early,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            # So that it does not stay a zombie when it ends.
            threading.Thread(target=process.wait, daemon=True).start()
            end = time.monotonic() + _START_S
            while time.monotonic() < end and self._leader() != process.pid:
                if process.poll() is not None and self._leader() != process.pid:
                    if process.returncode == BUSY:
                        raise _busy()
                    told = _tail(Path(early.name)) or _tail(self._folder / OUTPUT)
                    raise InputError(complaint(told, []), where="the workflow")
                time.sleep(0.05)

    def _leader(self) -> int | None:
        """Process of the last run, if it has begun."""
        with suppress(InputError):
            return int(read_json(self._folder / BEGUN)["pid"])
        return None

    def stop(self, firmly: bool) -> None:
        """Ask the run to stop, as Ctrl-C does; firmly: with SIGTERM.

        Raises
        ------
        InputError : no run of a studio.
        """
        with self._starting:
            leader = self._leader()
            if not self._is_alive() or leader is None:
                raise _none()
            about = read_json(self._folder / ORDER)
            # What failed after the first stop failed because of it.
            write_json(self._folder / ORDER, {"stop_s": time.time()} | about)
            try:
                os.killpg(leader, signal.SIGTERM if firmly else signal.SIGINT)
            except ProcessLookupError:
                raise _none() from None

    def unlock(self) -> None:
        """Remove the lock of a run that was killed.

        Raises
        ------
        InputError : a run holds it, or there is none.
        """
        with self._starting:
            if self._is_alive() or processes_outside(self._project.root):
                raise InputError("the workflow runs: its lock stays", where="studio")
            if not lock_is_there(self._project.root):
                raise InputError("there is no lock", where="studio")
            unlock(self._project)

    def state(self) -> dict[str, Any]:
        """The last run, if any, and whatever keeps another one from starting."""
        root, alive = self._project.root, self._is_alive()
        outside = processes_outside(root)
        about = {
            "running": alive,
            "outside": outside,
            "locked": not alive and not outside and lock_is_there(root),
            "most_cores": os.cpu_count() or 1,
            "usual": Order().model_dump(),
        }
        folder = self._folder
        if not (folder / ORDER).exists():
            return _NO_RUN | about
        order = read_json(folder / ORDER)
        ended = None
        with suppress(InputError):  # the next run removes it when it begins
            ended = read_json(folder / ENDED)
        return about | self._told(order, ended, alive)

    def _told(
        self, order: dict[str, Any], ended: dict[str, Any] | None, alive: bool
    ) -> dict[str, Any]:
        events = read_events(self._folder / EVENTS)
        progress = progress_of(events)
        now_s = time.time() if alive or ended is None else float(ended["time"])
        left_s, basis = remaining(progress, order["expected_s"], order["cores"], now_s)
        if alive:
            status = "stopping" if "stop_s" in order else "running"
        elif ended is None:
            status = "lost"
        elif ended["code"] == 0:
            status = "done"
        else:
            status = "stopped" if ended["stopped"] else "failed"
        described = {
            "order": {name: order[name] for name in ("site", "target", "cores")},
            "status": status,
            "begun_s": order["time"],
            "seconds": max(now_s - order["time"], 0.0),
            "left_s": left_s if alive else None,
            "basis": basis,
        }
        return described | self._steps(progress, alive, now_s, order.get("stop_s", now_s))

    def _steps(
        self, progress: Progress, alive: bool, now_s: float, stop_s: float
    ) -> dict[str, Any]:
        """Steps at work, finished and failed; one that a stop has ended did not fail."""

        def shown(jobs: list[Job]) -> list[dict[str, Any]]:
            return [job.described(now_s) for job in jobs]

        return {
            "done": progress.done,
            "total": progress.total,
            "steps": shown(progress.running) if alive else [],
            "last": shown(progress.finished[:_LAST_STEPS]),
            "failed": shown([job for job in progress.failed if (job.end_s or 0.0) <= stop_s]),
            "complaint": complaint(_tail(self._folder / OUTPUT), progress.messages),
        }

    def log(self, number: int) -> dict[str, Any]:
        """End of the log of a step that has begun.

        Raises
        ------
        InputError : no such step, or it has no log.
        """
        job = progress_of(read_events(self._folder / EVENTS)).jobs.get(number)
        if job is None or not job.logs:
            raise InputError("no log of such a step", where="studio", found=number)
        path = self._project.named(job.logs[0])
        return {"path": job.logs[0], "text": _tail(path)}


def _busy() -> InputError:
    return InputError("the workflow runs already", where="studio")


def _none() -> InputError:
    return InputError("no run that the studio started", where="studio")


def _tail(path: Path) -> str:
    """Last part of a text file; empty if there is none."""
    try:
        with path.open("rb") as file:
            file.seek(max(os.fstat(file.fileno()).st_size - _LOG_BYTES, 0))
            return file.read().decode("utf-8", errors="replace")
    except (FileNotFoundError, IsADirectoryError):
        return ""


# What work steps were in earlier runs, by the benchmark files that they left.
#
# Work is time of the processor: the time that passed depends on what else the machine did then.


def earlier_seconds(results: Path, sites: Collection[str]) -> dict[str, float]:
    """Mean seconds of work of a step of each rule: at the given sites, else at all others.

    Parameters
    ----------
    results : folder of the results, with ``<site>/benchmarks/**/<rule>.tsv``.
    sites : names of sites; none: all.
    """
    near: dict[str, list[float]] = {}
    far: dict[str, list[float]] = {}
    for folder in [*sorted(results.glob("*/benchmarks")), results / "benchmarks"]:
        own = not sites or folder.parent.name in sites or folder.parent == results
        for path in sorted(folder.rglob("*.tsv")):
            try:
                head, first, *_ = path.read_text(encoding="utf-8").split("\n")
                named = dict(zip(head.split("\t"), first.split("\t"), strict=True))
                seconds = _work_s(named)
            except (OSError, ValueError, KeyError):
                continue
            (near if own else far).setdefault(path.stem, []).append(seconds)
    return {rule: mean(values) for rule, values in (far | near).items()}


def _work_s(named: dict[str, str]) -> float:
    """Seconds of the processor; those that passed where the step was too short to be watched."""
    passed = float(named["s"])
    try:
        return float(named["cpu_time"]) or passed
    except (KeyError, ValueError):
        return passed


# Whether Snakemake works in the project's folder without the studio, or left its lock there.

_PROCESSES = Path("/proc")  # Where Linux lists processes
_LOCKS = ".snakemake/locks"  # Where Snakemake keeps its lock on a folder
_RUNNER = b"roadsight.studio.runner"  # By it the processes of the studio's own runs are known
# Calls of Snakemake with one of these do not hold its lock
_NO_LOCK = (b"--dry-run", b"--dryrun", b"-n", b"--unlock")


def lock_is_there(root: Path) -> bool:
    """Whether Snakemake's lock on the folder is there, held or left behind."""
    folder = root / _LOCKS
    return folder.is_dir() and any(folder.glob("*.lock"))


def processes_outside(root: Path) -> list[dict[str, Any]]:
    """Running calls of Snakemake in the folder that no studio started: their process numbers.

    Dry runs and other calls that take no lock do not count. Only processes of this machine and
    this user can be seen.
    """
    found: dict[int, tuple[int, list[bytes]]] = {}  # group and command line of each process
    for folder in _PROCESSES.glob("[0-9]*"):
        try:
            line = (folder / "cmdline").read_bytes().split(b"\0")
            if _calls_snakemake(line) and (folder / "cwd").readlink() == root:
                found[int(folder.name)] = os.getpgid(int(folder.name)), line
        except OSError:
            continue
    ours = {group for group, line in found.values() if any(_RUNNER in part for part in line)}
    return [
        {"pid": pid}
        for pid, (group, line) in sorted(found.items())
        if group not in ours and not any(part in _NO_LOCK for part in line)
    ]


def _calls_snakemake(line: list[bytes]) -> bool:
    """``snakemake ...``, ``python .../snakemake ...`` or ``python -m snakemake ...``."""
    if any(_RUNNER in part for part in line[:4]):
        return True
    return any(os.path.basename(part) == b"snakemake" for part in line[:3])  # noqa: PTH119
