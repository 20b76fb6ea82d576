"""A small site, run once through the real workflow in a copy of the checkout."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.kernels import bring_kernels

ROOT = Path(__file__).resolve().parents[2]

TINY_SITE = """\
site: tiny
title: Sixty metres of highway
sample: {scene: highway, points: 250000, length_m: 60}
jobs: [placement]
placement:
  edges: sample
  plans: [os-32, os-64]
settings:
  shards: 2
  candidates: {height_step_m: 2.0, spacing_m: 8.0}
  targets: {min_points: 10}
  coverage: {uncoverable: exclude, shards: 1}
"""


TINY_ROAD = """\
site: tiny_road
title: Rural road of 240 m
sample: {scene: rural, length_m: 240, pulses_per_m2: 20}
jobs: [poles]
settings:
  shards: 2
"""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of one finished site run beside each other, so that it is run once."""
    for item in items:
        shared = set(getattr(item, "fixturenames", ())) & {"finished", "finished_road"}
        for site in sorted(shared)[:1]:
            item.add_marker(pytest.mark.xdist_group(site))


class Checkout:
    """A copy of the project's own files in a folder of its own.

    Parameters
    ----------
    folder : where it is. site : the site that its runs are about.
    """

    def __init__(self, folder: Path, site: str = "tiny") -> None:
        self.folder, self.site = folder, site

    @classmethod
    def copy_to(cls, folder: Path, site: str = "tiny") -> Checkout:
        """Copy every tracked or new file of the project, but nothing that it generated."""
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True,
            text=True, check=True,
        ).stdout.splitlines()  # fmt: skip
        for name in listed:
            source, target = ROOT / name, folder / name
            if not source.exists() and not source.is_symlink():
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.is_symlink():
                target.symlink_to(source.readlink())
            else:
                shutil.copyfile(source, target)
        bring_kernels(ROOT, folder)
        (folder / "config/sites/tiny.yaml").write_text(TINY_SITE)
        (folder / "config/sites/tiny_road.yaml").write_text(TINY_ROAD)
        return cls(folder, site)

    def clone(self, folder: Path) -> Checkout:
        """Everything in another folder, results included."""
        shutil.copytree(self.folder, folder, symlinks=True)
        bring_kernels(self.folder, folder)
        return Checkout(folder, self.site)

    def snakemake(self, *arguments: str, timeout_s: float = 3600) -> subprocess.CompletedProcess:
        """Run Snakemake on the small site with this copy's package."""
        return subprocess.run(
            self.command(*arguments), cwd=self.folder, env=self.environment(), capture_output=True,
            text=True, timeout=timeout_s, check=False,
        )  # fmt: skip

    def command(self, *arguments: str) -> list[str]:
        """Command line of Snakemake on the small site."""
        command = [sys.executable, "-m", "snakemake", *arguments]
        return (
            command if "--config" in arguments else [*command, "--config", f"sites=[{self.site}]"]
        )

    def environment(self) -> dict[str, str]:
        """Environment in which Snakemake uses this copy's package."""
        return {
            "PATH": "/usr/bin:/bin",
            "HOME": str(self.folder),
            "PYTHONPATH": str(self.folder / "workflow"),
            "NUMBA_CACHE_DIR": str(self.folder.parent / "numba"),
        }

    def stale_rules(self, *arguments: str) -> set[str]:
        """Rules that a dry run would execute, targets left out."""
        result = self.snakemake("-n", *arguments)
        output = result.stdout + result.stderr
        assert result.returncode == 0, output
        if "Nothing to be done" in output:
            return set()
        table = output.split("Job stats:")[1].split("total")[0]
        return set(re.findall(r"^(\w+) +\d+$", table, re.MULTILINE)) - {"all", "job"}

    def records(self) -> dict[str, dict]:
        """What Snakemake noted of each file's step: its rule, its inputs, its command."""
        folder = self.folder / ".snakemake/metadata"
        return {
            base64.b64decode("".join(path.relative_to(folder).parts).replace("@", "")).decode():
            json.loads(path.read_text())
            for path in folder.rglob("*") if path.is_file()
        }  # fmt: skip

    def after(self, *rules: str) -> set[str]:
        """The rules and all that read what they wrote in the last run, directly or not."""
        records = self.records()
        reads = {
            (records[name]["rule"], record["rule"])
            for record in records.values()
            for name in record["input"]
            if name in records
        }
        found = set(rules)
        while more := {reader for writer, reader in reads if writer in found} - found:
            found |= more
        return found

    def edit(self, name: str, old: str, new: str) -> None:
        """Replace a text that must be there."""
        path = self.folder / name
        text = path.read_text()
        assert old in text, f"{old!r} is not in {name}"
        path.write_text(text.replace(old, new))


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    """A checkout whose small site has been run to the end."""
    checkout = Checkout.copy_to(tmp_path_factory.mktemp("workflow") / "checkout")
    result = checkout.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-8000:]
    return checkout


@pytest.fixture
def copy_of_finished(finished: Checkout, tmp_path: Path) -> Checkout:
    """The finished checkout in another folder, as a clone that brings its results along."""
    return finished.clone(tmp_path / "clone")


@pytest.fixture(scope="session")
def finished_road(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    """A checkout whose small pole site has been run to the end."""
    folder = tmp_path_factory.mktemp("road") / "checkout"
    checkout = Checkout.copy_to(folder, "tiny_road")
    result = checkout.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-8000:]
    return checkout


@pytest.fixture
def copy_of_road(finished_road: Checkout, tmp_path: Path) -> Checkout:
    """The finished checkout of the pole site in another folder."""
    return finished_road.clone(tmp_path / "clone")
