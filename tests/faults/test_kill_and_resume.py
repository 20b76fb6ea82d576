"""The workflow is struck at random moments and resumed: nothing is lost, nothing differs."""

import os
import shutil

import numpy as np
import pytest

from tests.faults.disturb import FAULTS, Disturbed, check_same, digests
from tests.workflow.conftest import Checkout

FAULT_SITES = {
    "fault": """\
site: fault
sample: {scene: highway, points: 60000, length_m: 40}
jobs: [placement]
placement:
  edges: sample
  plans: [os-64]
settings:
  shards: 2
  candidates: {height_step_m: 3.0, spacing_m: 10.0}
  targets: {min_points: 3}
  coverage: {uncoverable: exclude, shards: 1}
""",
    "fault_road": """\
site: fault_road
sample: {scene: rural, length_m: 80, pulses_per_m2: 10}
jobs: [poles]
settings:
  shards: 2
""",
}
MOMENTS = int(os.environ.get("ROADSIGHT_MOMENTS", "12"))
"""Moments at which runs are struck, two of each fault, the same in every run; more with
ROADSIGHT_MOMENTS=50."""
RESTARTS = [
    ["fault/placement/targets.parquet", "fault_road/poles/frames.parquet"],
    ["fault/scene/surfels.parquet", "fault_road/poles/masks/0.zip"],
    ["fault/scene/dem.tif", "fault_road/scene/dem.tif"],
    ["fault/placement/round-0/depth/OS1-64/1.parquet", "fault_road/poles/top.tif"],
]


@pytest.mark.full
def test_runs_struck_at_many_moments_lose_nothing(tmp_path):
    calm = Checkout.copy_to(tmp_path / "calm", ",".join(FAULT_SITES))
    for name, text in FAULT_SITES.items():
        (calm.folder / f"config/sites/{name}.yaml").write_text(text)
    shutil.copytree(calm.folder, tmp_path / "struck", symlinks=True)
    result = calm.snakemake("--cores", "2", timeout_s=1200)
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    expected = digests(calm.folder)
    # Known checksums go along; kernels are compiled anew, so that moments strike that, too.
    cache = ".snakemake/roadsight"
    shutil.copytree(calm.folder / cache, tmp_path / "struck" / cache, dirs_exist_ok=True)
    rng = np.random.default_rng(50)
    struck = Disturbed(Checkout(tmp_path / "struck", calm.site), rng)
    restarts = iter(RESTARTS * 2)
    moments = 0
    while moments < MOMENTS:
        if struck.strike(FAULTS[moments % len(FAULTS)]):
            moments += 1
        else:
            check_same(struck.checkout.folder, expected)
            struck.forget(*next(restarts))
    struck.finish()
    check_same(struck.checkout.folder, expected)
    assert struck.checkout.stale_rules() == set()
