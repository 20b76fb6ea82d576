"""Runs of the workflow that are struck by a fault at some moment, and what they did until then."""

import hashlib
import json
import re
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from tests.workflow.conftest import Checkout

Fault = Callable[[psutil.Process, list[psutil.Process], np.random.Generator], None]

TIMED = {"timing.json", "summary.json", "run.json", "page.json", "report.html", "report.pdf"}
"""Results that hold the time they took."""


def descendants(process: psutil.Process) -> list[psutil.Process]:
    with suppress(psutil.NoSuchProcess):
        return process.children(recursive=True)
    return []


def stages(process: psutil.Process) -> list[psutil.Process]:
    """Running stages of a workflow, each one process."""
    found = []
    for child in descendants(process):
        with suppress(psutil.NoSuchProcess):
            if "roadsight.stages" in " ".join(child.cmdline()[:3]):
                found.append(child)
    return found


def power_cut(controller, running, rng):
    """Everything ends at once."""
    for process in [controller, *descendants(controller)]:
        with suppress(psutil.NoSuchProcess):
            process.kill()


def controller_killed(controller, running, rng):
    """Snakemake is gone; its stages go on."""
    controller.kill()


def terminated(controller, running, rng):
    """Somebody asks Snakemake to stop."""
    controller.terminate()


def stage_killed(controller, running, rng):
    """The kernel kills a stage for the memory that it holds."""
    if running:
        with suppress(psutil.NoSuchProcess):
            running[rng.integers(len(running))].kill()


def disk_full(controller, running, rng):
    """No file of the stages may grow any more, now or in what starts later."""
    size = int(rng.choice([0, 2_000, 100_000]))
    for process in [*running, controller]:
        with suppress(psutil.NoSuchProcess, ProcessLookupError):
            hard = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)[1]
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, hard))


def memory_full(controller, running, rng):
    """Stages get no more address space than they hold."""
    for process in running:
        with suppress(psutil.NoSuchProcess, ProcessLookupError):
            size, hard = process.memory_info().vms, resource.RLIM_INFINITY
            resource.prlimit(process.pid, resource.RLIMIT_AS, (size, hard))


FAULTS: tuple[Fault, ...] = (
    power_cut, controller_killed, terminated, stage_killed, disk_full, memory_full,
)  # fmt: skip


@dataclass
class Run:
    """One call of Snakemake, watched through what it prints.

    Parameters
    ----------
    process : Snakemake. lines : what it has printed. started, finished : outputs of jobs.
    """

    process: subprocess.Popen
    lines: list[str] = field(default_factory=list)
    started: dict[int, list[str]] = field(default_factory=dict)
    finished: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._outputs: list[str] = []

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.append(line)
            if match := re.match(r"\s+output: (.*)", line):
                self._outputs = match[1].strip().split(", ")
            elif match := re.match(r"\s+jobid: (\d+)", line):
                self.started.setdefault(int(match[1]), self._outputs)
            elif match := re.match(r"Finished jobid: (\d+)", line):
                self.finished.update(self.started.get(int(match[1]), []))

    def wait_for_jobs(self, count: int, timeout_s: float = 120) -> bool:
        """Wait until that many jobs have begun; False if Snakemake ended before."""
        until = time.monotonic() + timeout_s
        while len(self.started) < count and self.process.poll() is None:
            assert time.monotonic() < until, "".join(self.lines[-40:])
            time.sleep(0.02)
        return self.process.poll() is None

    def end(self, timeout_s: float = 900) -> int:
        """Wait for its end; a stage that outlives it does not hold the test up."""
        try:
            code = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(
                f"still there: {self._processes()}\n{self.text[-6000:]}"
            ) from error
        self._reader.join(0.5)
        return code

    def _processes(self) -> list[str]:
        """What runs, its state and the seconds of a processor that it has had."""
        told = []
        for process in descendants(psutil.Process(self.process.pid)):
            with suppress(psutil.NoSuchProcess):
                times, name = process.cpu_times(), " ".join(process.cmdline()[:6])
                told.append(f"{name} ({process.status()}, {times.user + times.system:.0f} s)")
        return told

    @property
    def text(self) -> str:
        return "".join(self.lines)

    @property
    def outputs(self) -> set[str]:
        """Outputs of all jobs that began."""
        return {name for names in self.started.values() for name in names}


class Disturbed:
    """A checkout in which faults strike one run after the other.

    Parameters
    ----------
    checkout : where. rng : draws the moments.
    """

    def __init__(self, checkout: Checkout, rng: np.random.Generator) -> None:
        self.checkout, self._rng = checkout, rng
        self._kept: set[str] = set()

    def start(self) -> Run:
        return Run(
            subprocess.Popen(
                self.checkout.command("--cores", "2", "--printshellcmds"), cwd=self.checkout.folder,
                env=self.checkout.environment() | {"PYTHONUNBUFFERED": "1"}, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, start_new_session=True,
            )
        )  # fmt: skip

    def strike(self, fault: Fault) -> bool:
        """Run until a random moment, then let the fault strike; False if there was nothing to do.

        Asserts that what was finished before is not done again.
        """
        run = self.start()
        if run.wait_for_jobs(int(self._rng.integers(1, 5))):
            time.sleep(self._rng.uniform(0, 1.5))
        ended_before = run.process.poll() is not None
        kept = set(run.finished)
        if not ended_before:
            controller = psutil.Process(run.process.pid)
            fault(controller, stages(controller), self._rng)
        code = run.end()
        self._check_kept(run)
        self._kept |= kept if fault is disk_full else run.finished
        if code == -signal.SIGKILL:
            self.unlock()
        return not ended_before

    def finish(self) -> Run:
        """Run to the end, which now nothing hinders."""
        run = self.start()
        assert run.end() == 0, run.text[-6000:]
        self._check_kept(run)
        return run

    def unlock(self) -> None:
        """The one documented command after Snakemake itself was killed."""
        result = self.checkout.snakemake("--unlock")
        assert result.returncode == 0, result.stdout + result.stderr

    def _check_kept(self, run: Run) -> None:
        again = self._kept & run.outputs
        assert not again, f"done again: {sorted(again)}\n{run.text[-4000:]}"

    def forget(self, *names: str) -> None:
        """Remove results and all that their site wrote later, so that they are to be done again."""
        results = self.checkout.folder / "results"
        for name in names:
            since = (results / name).stat().st_mtime_ns
            site = [*(results / name.split("/")[0]).rglob("*"), results / "report.html"]
            for path in site:
                if path.is_file() and path.stat().st_mtime_ns >= since:
                    path.unlink()
        self._kept.clear()


def digests(folder: Path) -> dict[str, str]:
    """Digest of every result by name; of the summaries without the time that things took."""
    found = {}
    for path in sorted((folder / "results").rglob("*")):
        if path.is_file() and "benchmarks" not in path.parts:
            content = path.read_bytes()
            if path.name == "summary.json":
                content = json.dumps(_untimed(json.loads(content)), sort_keys=True).encode()
            name = path.relative_to(folder).as_posix()
            timed = path.name in TIMED - {"summary.json"}
            found[name] = "timed" if timed else hashlib.sha256(content).hexdigest()
    return found


def _untimed(content):
    if isinstance(content, dict):
        return {k: _untimed(v) for k, v in content.items() if not k.startswith("seconds")}
    return [_untimed(v) for v in content] if isinstance(content, list) else content


def check_same(folder, expected):
    """The same bytes, and nothing half-written beside them."""
    found = digests(folder)
    different = {name for name in expected | found if expected.get(name) != found.get(name)}
    assert different == set()
    assert len(found) > 20
