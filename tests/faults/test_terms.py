"""TERM ends a run at whatever moment it comes."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from snakemake.scheduling.job_scheduler import JobScheduler

from snakemake_logger_plugin_roadsight import stopping
from tests.conftest import PROJECT

TERMS, RUNS = 200, 20
HANGS_AFTER_S = 60.0
SNAKEFILE = """\
from snakemake_logger_plugin_roadsight.stopping import let_stops_through

let_stops_through()


rule all:
    input:
        expand("{n}.txt", n=range(60)),


rule fails:
    output:
        "{n}.txt",
    shell:
        "false"
"""


class Scheduler:
    """What the handler needs of Snakemake's scheduler."""

    def __init__(self):
        self._lock = threading.Lock()
        self._open_jobs = threading.Semaphore(0)
        self._user_kill = None


@pytest.fixture
def handled():
    """Install a handler for TERM, and put the old one back."""
    before = signal.getsignal(signal.SIGTERM)
    yield lambda handler: signal.signal(signal.SIGTERM, handler)
    signal.signal(signal.SIGTERM, before)


def test_a_term_within_the_locks_returns(handled):
    scheduler = Scheduler()
    handled(lambda *about: stopping.exit_gracefully(scheduler, *about))
    with scheduler._lock, scheduler._open_jobs._cond:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        assert scheduler._user_kill == "graceful"
        assert scheduler._open_jobs._value == 0
    assert scheduler._open_jobs.acquire(timeout=10)


def test_the_handler_that_is_replaced_is_the_one_that_hangs():
    """Should Snakemake mend its own, ours can go."""
    scheduler = Scheduler()
    own = JobScheduler.exit_gracefully
    if own is stopping.exit_gracefully:
        pytest.skip("replaced already in this process")
    with scheduler._lock:
        waiting = threading.Thread(target=own, args=(scheduler,), daemon=True)
        waiting.start()
        waiting.join(0.2)
        assert waiting.is_alive()
    waiting.join(10)
    assert not waiting.is_alive()


@pytest.mark.full
def test_no_run_hangs(tmp_path):
    rng = np.random.default_rng(3)
    environment = os.environ | {"PYTHONPATH": str(PROJECT / "workflow"), "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "snakemake", "--cores", "8", "--keep-going", "--quiet"]
    for number in range(RUNS):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "Snakefile").write_text(SNAKEFILE)
        run = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        until = time.monotonic() + HANGS_AFTER_S
        while not (folder / ".snakemake" / "log").is_dir() and time.monotonic() < until:
            time.sleep(0.02)
        time.sleep(rng.uniform(0.3, 2.0))
        for _ in range(TERMS // RUNS):
            if run.poll() is not None:
                break
            run.send_signal(signal.SIGTERM)
            time.sleep(rng.uniform(0, 0.1))
        try:
            run.wait(HANGS_AFTER_S)
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            pytest.fail(f"run {number} hangs")
