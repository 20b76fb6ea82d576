"""The profile for other clusters, with a stand-in for their submit command.

The stand-in starts the script that it is given on this machine and prints a number, as any cluster
does.
"""

import importlib.util
import json

import pytest

from tests.workflow.conftest import TINY_SITE, Checkout

PLUGIN = "snakemake_executor_plugin_cluster_generic"

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec(PLUGIN) is None, reason=f"{PLUGIN} is missing"
)


def test_jobs_are_submitted_with_their_resources(tmp_path):
    checkout = Checkout.copy_to(tmp_path / "checkout")
    small = TINY_SITE.replace("points: 250000, length_m: 60", "points: 60000, length_m: 40")
    (checkout.folder / "config/sites/tiny.yaml").write_text(small)
    submit = tmp_path / "submit.sh"
    submit.write_text(
        "#!/bin/sh\n"
        f'echo "$1 $2 $3" >> {tmp_path}/submitted\n'
        f'setsid sh "$4" > {tmp_path}/job.$$ 2>&1 &\n'
        "echo $$\n"
    )
    submit.chmod(0o755)
    result = checkout.snakemake(
        "results/tiny/scene/profile.json",
        "--workflow-profile",
        "workflow/profiles/generic",
        "--cluster-generic-submit-cmd",
        f"{submit} {{rule}} {{threads}} {{resources.mem_mb}}:{{resources.runtime}}",
        "--latency-wait",
        "5",
        "--seconds-between-status-checks",
        "1",
    )
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    profile = json.loads((checkout.folder / "results/tiny/scene/profile.json").read_text())
    assert profile
    lines = [line.split() for line in (tmp_path / "submitted").read_text().splitlines()]
    assert [line[0] for line in lines] == ["generate_sample", "ingest_cloud", "profile_scene"]
    assert lines[0][1:] == ["1", "2000:60"]
