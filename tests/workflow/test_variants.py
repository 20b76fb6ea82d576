"""A variant runs what its change touches, shares the rest and leaves its base alone."""

import hashlib
from pathlib import Path

import pytest

from roadsight.base.errors import InputError
from roadsight.base.texts import read_yaml
from roadsight.config.load import load_config
from roadsight.evidence.variants import Variant, VariantError, mirror_site
from tests.workflow.conftest import Checkout

SOLUTION = "placement/os-64/solution.json"


def digests(checkout: Checkout) -> dict[str, tuple[str, int]]:
    """Content and date of all files that the run made."""
    return {
        str(path.relative_to(checkout.folder)): (
            hashlib.sha256(path.read_bytes()).hexdigest(),
            path.stat().st_mtime_ns,
        )
        for part in ("results", "logs", ".snakemake/metadata")
        for path in sorted((checkout.folder / part).rglob("*"))
        if path.is_file()
    }


def prepared(checkout: Checkout, folder: Path, changes: dict, plans: tuple[str, ...] = ()):
    content = read_yaml(checkout.folder / "config/config.yaml") | {"sites": [checkout.site]}
    config = load_config(content).model_dump()
    return Variant.prepare(checkout.folder, folder, config, checkout.site, changes, plans)


@pytest.fixture
def in_base(finished: Checkout, monkeypatch: pytest.MonkeyPatch) -> Checkout:
    """The finished site, with its own package for the nested runs."""
    package = finished.folder / "workflow"
    monkeypatch.setattr("roadsight.evidence.variants._PACKAGE", package)
    return finished


def test_a_change_runs_what_depends_on_it_and_nothing_else(in_base: Checkout, tmp_path: Path):
    before = digests(in_base)
    variant = prepared(in_base, tmp_path / "variant", {"targets": {"cell_size_m": 2.0}})
    ran = variant.run([SOLUTION])
    expected = in_base.after("place_targets") - {
        "find_obstacles", "render_scans", "measure_data", "summarise_site", "write_site_page",
        "write_report", "write_pdf", "write_handover", "write_stakeout", "measure_tolerance",
        "try_removals",
    }  # fmt: skip
    assert set(ran) == expected
    assert digests(in_base) == before
    changed, base = variant.result(SOLUTION), in_base.folder / "results/tiny" / SOLUTION
    assert changed.read_bytes() != base.read_bytes()
    shared = "scene/surfels.parquet"
    assert variant.result(shared).samefile(in_base.folder / "results/tiny" / shared)

    records = variant.records([SOLUTION])
    assert {record.rule for record in records if record.ran} == expected
    assert {record.rule for record in records if not record.ran} >= {"build_dem", "build_surfels"}
    assert all(record.cpu_s > 0.05 and record.peak_mib > 20 for record in records)
    assert all(record.wall_s >= 0 for record in records)
    assert not any("os-32/" in record.log for record in records)

    solving = [record for record in records if record.rule == "solve_cover"]
    again = variant.repeat([SOLUTION], solving, times=2)
    assert [[record.rule for record in run] for run in again] == [["solve_cover"]] * 2
    assert variant.run([SOLUTION]) == {}
    assert digests(in_base) == before


def test_without_a_change_nothing_runs(in_base: Checkout, tmp_path: Path):
    variant = prepared(in_base, tmp_path / "variant", {})
    assert variant.run([SOLUTION]) == {}


def test_the_same_change_in_the_site_file_gives_the_same_bytes(
    in_base: Checkout, copy_of_finished: Checkout, tmp_path: Path
):
    changes = {"targets": {"cell_size_m": 2.0}}
    variant = prepared(in_base, tmp_path / "variant", changes, ("os-64",))
    variant.run([SOLUTION], cores=2)
    copy_of_finished.edit(
        "config/sites/tiny.yaml", "min_points: 10", "min_points: 10, cell_size_m: 2.0"
    )
    copy_of_finished.edit("config/sites/tiny.yaml", "[os-32, os-64]", "[os-64]")
    result = copy_of_finished.snakemake(f"results/tiny/{SOLUTION}", "--cores", "2")
    assert result.returncode == 0, result.stdout + result.stderr
    expected = copy_of_finished.folder / "results/tiny" / SOLUTION
    assert variant.result(SOLUTION).read_bytes() == expected.read_bytes()


def test_a_failing_run_says_what_snakemake_said(in_base: Checkout, tmp_path: Path):
    variant = prepared(in_base, tmp_path / "variant", {"lidar": {"modle": "hybrid"}})
    with pytest.raises(VariantError, match=r"overrides: unknown key 'lidar.modle'.*'model'"):
        variant.run([SOLUTION])


def test_a_failing_job_says_what_its_stage_said(in_base: Checkout, tmp_path: Path):
    variant = prepared(in_base, tmp_path / "variant", {"targets": {"cell_size_m": 2.0}})
    pavement = variant.result("scene/pavement.gpkg")
    pavement.unlink()
    pavement.write_bytes(b"none")
    said = r"variant: the workflow failed; found results/\S+pavement.gpkg: cannot be read as vector"
    with pytest.raises(VariantError, match=said):
        variant.run([SOLUTION])


def test_a_site_without_results_is_refused(tmp_path: Path):
    (tmp_path / "base").mkdir()
    with pytest.raises(InputError, match="has no results to start from"):
        mirror_site(tmp_path / "base", tmp_path / "variant", "tiny")
    assert not (tmp_path / "variant").exists()
