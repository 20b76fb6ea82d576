"""Both jobs on a real SLURM: arrays, a cancelled job, one without memory, a killed controller.

Needs SLURM's programs, the plugin and, in ROADSIGHT_SLURM, a
folder with ``start.sh``, ``stop.sh`` and ``slurm.conf.in`` that start and stop a throw-away cluster
under $DIR.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.faults.disturb import Disturbed, Run, check_same, digests
from tests.faults.test_kill_and_resume import FAULT_SITES
from tests.workflow.conftest import Checkout

PLUGIN = "snakemake_executor_plugin_slurm"
FOLDER = Path(os.environ.get("ROADSIGHT_SLURM") or "/nonexistent")
ENFORCED = """
JobAcctGatherParams=OverMemoryKill
"""

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(importlib.util.find_spec(PLUGIN) is None, reason=f"{PLUGIN} is missing"),
    pytest.mark.skipif(shutil.which("slurmctld") is None, reason="SLURM is not installed"),
    pytest.mark.skipif(not FOLDER.is_dir(), reason="ROADSIGHT_SLURM names no folder"),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Environment that reaches a cluster of one node, which kills jobs for their memory."""
    folder = tmp_path_factory.mktemp("slurm")
    scripts = shutil.copytree(FOLDER, folder / "scripts")
    (scripts / "slurm.conf.in").chmod(0o644)
    scripts.chmod(0o755)
    conf = (scripts / "slurm.conf.in").read_text()
    conf = conf.replace("JobAcctGatherType=@JAG@", "JobAcctGatherType=jobacct_gather/linux")
    conf = re.sub("JobAcctGatherFrequency=.*", "JobAcctGatherFrequency=1", conf) + ENFORCED
    (scripts / "slurm.conf.in").write_text(conf)
    control = os.environ | {"DIR": str(folder / "run"), "CPUS": "2", "MEM": "8000"}
    started = subprocess.run(
        ["bash", scripts / "start.sh"], env=control, capture_output=True, text=True, check=False
    )
    assert started.returncode == 0, started.stdout + started.stderr
    yield {
        "SLURM_CONF": str(folder / "run/slurm.conf"),
        "PATH": f"{folder / 'run/bin'}:{Path(sys.executable).parent}:/usr/bin:/bin",
    }
    subprocess.run(["bash", scripts / "stop.sh", "--purge"], env=control, check=False)


class ClusterCheckout(Checkout):
    """A checkout whose runs go to SLURM."""

    slurm: dict[str, str]
    options: tuple[str, ...] = ()

    def command(self, *arguments: str) -> list[str]:
        local = {"--cores", "2"}
        kept = [argument for argument in arguments if argument not in local]
        profile = ("--workflow-profile", "workflow/profiles/slurm", "--slurm-no-account")
        quick = ("--slurm-status-command", "squeue", "--seconds-between-status-checks", "2")
        quick += ("--slurm-init-seconds-before-status-checks", "4", "--latency-wait", "10")
        return super().command(*kept, *profile, *quick, *self.options)

    def environment(self) -> dict[str, str]:
        return super().environment() | self.slurm


def tell(cluster, *command: str) -> str:
    result = subprocess.run(
        command, env=os.environ | cluster, capture_output=True, text=True, check=False
    )
    return result.stdout


def job_of(cluster, rule: str, run: Run, timeout_s: float = 300) -> str:
    """Number of a running SLURM job of a rule."""
    until = time.monotonic() + timeout_s
    while time.monotonic() < until and run.process.poll() is None:
        for line in tell(cluster, "squeue", "-h", "-t", "R", "-o", "%A %k").splitlines():
            number, _, comment = line.partition(" ")
            if rule in comment:
                return number
        time.sleep(0.2)
    raise AssertionError(f"no job of {rule}:\n{run.text[-4000:]}")


@dataclass(frozen=True)
class Misfortune:
    """What happens to a run: jobs of these rules are cancelled, starved, or running at the end."""

    cancelled: str
    starved: str
    running_at_the_end: str


def run_with(there: ClusterCheckout, misfortune: Misfortune) -> None:
    """Cancel a job, let one run out of memory, kill the controller, resume to the end."""
    # Far too little for the first attempt, enough for the second.
    there.options = ("--set-resources", f"{misfortune.starved}:mem_mb=100 * 15 ** (attempt - 1)")
    struck = Disturbed(there, np.random.default_rng(0))
    run = struck.start()
    tell(there.slurm, "scancel", job_of(there.slurm, misfortune.cancelled, run))
    job_of(there.slurm, misfortune.running_at_the_end, run)
    finished = set(run.finished)
    run.process.kill()
    run.end()
    for _ in range(100):
        if not tell(there.slurm, "squeue", "-h", "-t", "R,PD").strip():
            break
        time.sleep(1)
    struck.unlock()
    again = struck.start()
    assert again.end(timeout_s=1800) == 0, again.text[-6000:]

    text = run.text + again.text
    retried = re.findall(r"Error in rule (\w+)", text)
    assert {misfortune.cancelled, misfortune.starved} <= set(retried), text[-6000:]
    assert text.count("Trying to restart job") >= 2
    # What was finished when the controller died is not done again.
    assert not finished & again.outputs
    assert "Submitted array job" in text


def test_both_jobs_on_a_cluster_that_fails(cluster, tmp_path):
    calm = Checkout.copy_to(tmp_path / "calm", ",".join(FAULT_SITES))
    for name, text in FAULT_SITES.items():
        (calm.folder / f"config/sites/{name}.yaml").write_text(text)
    shutil.copytree(calm.folder, tmp_path / "cluster", symlinks=True)
    result = calm.snakemake("--cores", "2", timeout_s=1200)
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    there = ClusterCheckout(tmp_path / "cluster", calm.site)
    there.slurm = cluster
    run_with(there, Misfortune("ingest_cloud", "build_dem", "rasterise_lidar"))
    check_same(there.folder, digests(calm.folder))
