"""A whole job by Open3D comes to the same as by ourselves."""

import json
import re
from pathlib import Path

import numpy as np

from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.tables import read_table
from tests.helpers.engines import needs_open3d
from tests.workflow.conftest import Checkout

ENGINES = """\
  shards: 2
  pavement: {fpfh_engine: open3d, cluster_engine: open3d}
  lidar: {engine: open3d}
"""


def test_a_job_by_open3d(finished: Checkout, copy_of_finished: Checkout) -> None:
    needs_open3d()
    copy_of_finished.edit("config/sites/tiny.yaml", "  shards: 2\n", ENGINES)
    result = copy_of_finished.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-4000:]
    own, peer = (run.folder / "results/tiny" for run in (finished, copy_of_finished))

    scores = [json.loads((r / "scene/pavement_scores.json").read_text()) for r in (own, peer)]
    assert abs(scores[0]["f1"] - scores[1]["f1"]) < 1e-3
    classes = [read_table(run / "scene/fpfh_clusters.parquet")["smooth"] for run in (own, peer)]
    assert (classes[0] == classes[1]).mean() > 0.999
    files = sorted((own / "placement").glob("round-*/depth/*/*.parquet"))
    assert files
    beams = off = 0
    for file in files:
        pairs = zip(DepthMaps(file), DepthMaps(peer / file.relative_to(own)), strict=True)
        for (name, ours), (same, theirs) in pairs:
            assert name == same
            beams, off = beams + ours.size, off + int((np.abs(ours - theirs) > 0.02).sum())
    assert off < 1e-4 * beams
    for plan in ("os-32", "os-64"):
        found = [
            json.loads((run / f"placement/{plan}/solution.json").read_text())["sensors"]
            for run in (own, peer)
        ]
        assert [s["candidate"] for s in found[0]] == [s["candidate"] for s in found[1]]


def test_its_lock_counts_where_it_is_asked_for(tmp_path: Path) -> None:
    needs_open3d()
    checkout = Checkout.copy_to(tmp_path / "project")

    def readers() -> set[str]:
        """Rules that read the lock of Open3D."""
        told = checkout.snakemake("--cores", "1", "--dry-run")
        assert told.returncode == 0, told.stdout[-4000:] + told.stderr[-4000:]
        jobs = re.findall(r"^(?:local)?rule (\w+):\n((?: .*\n)+)", told.stdout, re.MULTILINE)
        assert {name for name, text in jobs if f"/sources/{name}" in text}
        return {name for name, text in jobs if "envs/requirements-open3d.lock" in text}

    assert readers() == set()
    checkout.edit("config/sites/tiny.yaml", "  shards: 2\n", ENGINES)
    rays = {"render_depth_maps", "find_obstacles", "render_scans", "measure_tolerance"}
    assert readers() == {"extract_pavement", "try_removals", *rays}
