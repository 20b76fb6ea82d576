"""The benchmarks run: what they say is measured, and no program of theirs fails unseen."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.full


def test_all_programs_run_on_small_workloads(tmp_path):
    out = tmp_path / "bench.json"
    command = [sys.executable, ROOT / "benchmarks/run.py", "--size", "quick", "--out", out]
    subprocess.run(command, cwd=ROOT, check=True)
    rows = json.loads(out.read_text())
    programs = {row["kernel"].split(",")[0].split(" OS-")[0].split(" VLP-")[0] for row in rows}
    assert len(programs) >= 8
    for row in rows:
        assert row["cpu_s_ours"] > 0, row
        assert row["cpu_s_against"] > 0, row
        assert row["ratio"] == pytest.approx(row["cpu_s_against"] / row["cpu_s_ours"]), row
    proofs = [row for row in rows if row["kernel"] == "set cover with proof"]
    assert [row["agreement"] for row in proofs] == [1.0]
    assert out.with_name("index.html").stat().st_size > 0


def test_whole_job_is_compared_by_the_sensors_that_its_plans_use(monkeypatch):
    summary = ROOT / "results/sample/summary.json"
    if not summary.is_file():
        pytest.skip("the sample has not been run here")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import bench_jobs

    row = bench_jobs._placement()
    assert row["workload"].endswith(f"{len(json.loads(summary.read_text())['sensors'])} sensors")
    assert row["cpu_s_against"] > row["cpu_s_ours"] > 0


def test_memory_of_a_program_is_its_own(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    from bench_measure import measured_apart

    held = bytearray(300 * 2**20)
    held[:: 2**12] = b"1" * len(held[:: 2**12])  # pages count once they are written
    used = measured_apart([sys.executable, "-c", "sum(range(1_000_000))"])
    assert 0 < used.cpu_s < 60
    assert used.wall_s > 0
    assert 1 < used.peak_mib < 100
    with pytest.raises(RuntimeError, match="failed"):
        measured_apart([sys.executable, "-c", "raise SystemExit(3)"])
