"""The whole site: it builds without a warning, no link is broken, nothing is fetched."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.pages.links import broken_links
from tests.conftest import PROJECT

pytestmark = [pytest.mark.full, pytest.mark.xdist_group("site")]


def build(project: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """What ``make docs`` runs."""
    command = [sys.executable, "-m", "scripts.pages.build", str(out)]
    path = os.pathsep.join([str(project / "workflow"), str(project)])
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(
        command, cwd=project, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site."""
    out = tmp_path_factory.mktemp("site")
    run = build(PROJECT, out)
    assert run.returncode == 0, run.stderr
    return out / "html"


def test_every_link_leads_somewhere_and_nothing_is_fetched(site: Path):
    assert broken_links(site) == []


def test_pages_that_are_generated_are_there(site: Path):
    for page in ("settings", "sensors", "verbs", "api/index", "api/placement.sight"):
        assert (site / "reference" / f"{page}.html").is_file(), page
    for page in ("tradeoffs", "truth", "bench"):
        assert (site / "results" / f"{page}.html").is_file(), page


def test_formulas_are_drawn_without_a_script(site: Path):
    page = (site / "method" / "placement.html").read_text("utf-8")
    assert page.count("<math") > 10
    assert "merror" not in page
    assert not re.search(r"\\(frac|sum|theta)\b", re.sub(r"<annotation.*?</annotation>", "", page))


def test_a_broken_link_fails_the_build(tmp_path: Path):
    copy = tmp_path / "project"
    for folder in ("docs", "scripts", "config", "benchmarks", "workflow/roadsight"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(PROJECT / folder, copy / folder, ignore=ignore)
    for name in ("CONTRIBUTING.md", "CHANGELOG.md"):
        shutil.copy(PROJECT / name, copy / name)
    page = copy / "docs" / "glossary.md"
    page.write_text(
        page.read_text("utf-8") + "\n[gone](gone.md) and [no place](index.md#nowhere)\n"
    )
    run = build(copy, tmp_path / "out")
    assert run.returncode == 1
    assert "gone.md" in run.stderr
    assert "nowhere" in run.stderr
