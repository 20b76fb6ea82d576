"""Calls of Snakemake: only with targets and sites of fixed lists, and never through a shell."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

import roadsight
from roadsight.base.errors import InputError
from roadsight.studio.project import Project
from roadsight.studio.run.progress import progress_of
from roadsight.studio.run.run_events import read_events

_PACKAGES = Path(roadsight.__file__).resolve().parents[1]
_OURS = "roadsight: "
_DRY_RUN_S = 300.0
"""Limit of a dry run, which takes longer with the steps of all sites."""
_UNLOCK_S = 120.0
"""Limit of removing a lock."""


class Order(BaseModel):
    """What is to be made: for one site by the name of its file, or for those of the settings."""

    model_config = ConfigDict(extra="forbid")
    site: Annotated[str, Field(max_length=200)] | None = None
    target: Literal[
        "all", "placement", "poles", "scene", "report", "tradeoffs", "audit", "hardcases"
    ] = "all"
    cores: Annotated[int, Field(ge=1, le=1024)] = 2


def command(project: Project, order: Order, events: Path) -> list[str]:
    """Command line of an order.

    Raises
    ------
    InputError : no such site.
    """
    config = []
    if order.site is not None:
        if order.site not in project.stems():
            raise InputError("no such site", where="studio", found=order.site)
        config = ["--config", f"sites={json.dumps([order.site])}"]
    return [
        sys.executable,
        "-m",
        "snakemake",
        order.target,
        "--cores",
        str(order.cores),
        "--nocolor",
        "--logger",
        "roadsight",
        "--logger-roadsight-events",
        str(events),
        *config,
    ]


def environment() -> dict[str, str]:
    """Environment in which Snakemake and its steps find this package."""
    found = [str(_PACKAGES), *filter(None, [os.environ.get("PYTHONPATH")])]
    programs = [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]
    return os.environ | {"PYTHONPATH": os.pathsep.join(found), "PATH": os.pathsep.join(programs)}


def dry_run(project: Project, order: Order) -> list[dict[str, Any]]:
    """Events of a dry run.

    Raises
    ------
    InputError : what Snakemake says where it cannot plan the run, or it takes too long.
    """
    with _scratch(project) as folder:
        events = folder / "events.jsonl"
        result = _call([*command(project, order, events), "--dry-run"], project, _DRY_RUN_S)
        found = read_events(events)
        if result.returncode != 0:
            raise InputError(
                complaint(result.stdout, progress_of(found).messages), where="the workflow"
            )
        return found


def unlock(project: Project) -> None:
    """Remove the lock that a killed run left behind.

    Raises
    ------
    InputError : what Snakemake says where it cannot.
    """
    result = _call([sys.executable, "-m", "snakemake", "--unlock"], project, _UNLOCK_S)
    if result.returncode != 0:
        raise InputError(complaint(result.stdout, []), where="snakemake --unlock")


def complaint(output: str, told: list[str]) -> str:
    """What went wrong, of the output of a call that failed and of the errors that it told."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    ours = [line.removeprefix(_OURS) for line in lines if line.startswith(_OURS)]
    return next(iter(ours + told), lines[-1] if lines else "ended without a word")


def _call(line: list[str], project: Project, timeout_s: float) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            line,
            cwd=project.root,
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(f"did not answer in {timeout_s:.0f} s", where="snakemake") from error


@contextmanager
def _scratch(project: Project) -> Iterator[Path]:
    folder = project.inside(".snakemake/roadsight")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix="dry-run-") as name:
        yield Path(name)
