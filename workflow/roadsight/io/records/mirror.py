"""A work folder that shares a finished site's files with another one, which it cannot change."""

from __future__ import annotations

import os
import shutil
from base64 import urlsafe_b64decode
from pathlib import Path

from roadsight.base.errors import InputError
from roadsight.io.records.sources import package_digest

_OWN = {"results", "logs", ".snakemake", ".git"}
"""What a mirror has of its own; everything else of the project is linked."""
_METADATA = Path(".snakemake/metadata")
"""What Snakemake knows of outputs: without it, all of them would be stale."""


def mirror_site(base: Path, folder: Path, site: str) -> None:
    """Fill ``folder`` with what a run needs to go on from the finished ``site`` of ``base``.

    Results are hard links, or copies on another file system: Snakemake deletes an output before it
    makes it anew and stages rename theirs into place, so nothing is written through a link. What
    is written in place (logs, benchmark files, Snakemake's records) is copied. Everything else of
    the project is linked. A folder that is already there is replaced.

    Raises
    ------
    InputError : the site has no results in ``base``.
    """
    if not (base / "results" / site).is_dir():
        raise InputError(
            f"site {site!r} has no results to start from",
            where=str(base / "results"),
            hint=f"run the workflow on {site} first",
        )
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for entry in sorted(base.iterdir()):
        if entry.name not in _OWN:
            (folder / entry.name).symlink_to(entry.resolve())
    _copy(base, folder, Path("logs") / site)
    _link_results(base, folder, Path("results") / site)
    _copy_records(base / _METADATA, folder / _METADATA, f"results/{site}/")
    _share_caches(base / ".snakemake/roadsight", folder / ".snakemake/roadsight")


def _copy(base: Path, folder: Path, part: Path) -> None:
    if (base / part).is_dir():
        shutil.copytree(base / part, folder / part)


def _link_results(base: Path, folder: Path, part: Path) -> None:
    benchmarks = base / part / "benchmarks"

    def place(source: str, target: str) -> None:
        if Path(source).is_relative_to(benchmarks):
            shutil.copy2(source, target)
        else:
            _link_or_copy(source, target)

    shutil.copytree(
        base / part, folder / part, copy_function=place, ignore=shutil.ignore_patterns(".*.tmp*")
    )


def _link_or_copy(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _copy_records(source: Path, target: Path, prefix: str) -> None:
    """Snakemake's records of the files whose path starts with ``prefix``."""
    # Snakemake takes a folder of records without this one for one of an old version.
    (target.parent / "incomplete").mkdir(parents=True)
    for record in sorted(path for path in source.rglob("*") if path.is_file()):
        name = record.relative_to(source)
        encoded = "".join(part.removeprefix("@") for part in name.parts)
        if urlsafe_b64decode(encoded).decode().startswith(prefix):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(record, target / name)


def _share_caches(source: Path, target: Path) -> None:
    """Compiled kernels, which both may add to, and the checksums of input files."""
    target.mkdir(parents=True)
    kernels = source / f"numba-{package_digest()}"
    kernels.mkdir(parents=True, exist_ok=True)
    (target / kernels.name).symlink_to(kernels.resolve())
    if (source / "checksums.json").is_file():
        shutil.copy2(source / "checksums.json", target)
