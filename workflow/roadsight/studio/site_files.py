"""Files beside a site's settings, and the names of them in the site file."""

from __future__ import annotations

import hashlib
import json
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import yaml

from roadsight.base.errors import InputError
from roadsight.config.load import resolve_site
from roadsight.config.plan_options import FILES
from roadsight.io.records.atomic import atomic_path
from roadsight.studio.project import FRAME, Project, SiteFolder
from roadsight.studio.site_text import with_value

Writer = Callable[[Path], Any]
Part = Literal["drawing", "decisions", "registration", "plans"]
_SAMPLE_EDGES = "sample/edges.geojson"
_FILES: dict[Part, tuple[str, dict[str, str], tuple[str, ...]]] = {
    "drawing": (
        "placement",
        {name: f"{name}.geojson" for name in ("edges", "zones", "mounts", "tma")},
        (FRAME, _SAMPLE_EDGES),
    ),
    "decisions": ("poles", {"decisions": "pole_decisions.csv"}, (FRAME,)),
    "registration": (
        "poles",
        {"baseline": "baseline.json", "corrections": "corrections.csv"},
        (FRAME, "poles/frames.parquet"),
    ),
    "plans": ("placement", {}, ()),
}
"""Of each part that people save: section, its keys with the files that the studio writes for them,
and the results that it rests on."""
_NAMES = {key: name for _, names, _ in _FILES.values() for key, name in names.items()}
_saving = threading.RLock()


class OutdatedError(InputError):
    """What was to be saved rests on files that have changed since."""


def site_version(site: SiteFolder, part: Part) -> str:
    """A short text that changes with what a part of a site was read from."""
    section, keys, results = _FILES[part]
    named = [site.resolved.beside(_named(site, section, key)) for key in keys]
    plans = site.resolved.site.placement.own_plans if part == "plans" else {}
    files = (plan.file_of(option) for plan in plans.values() for option in FILES)
    named += [site.resolved.beside(file) for file in files]
    paths = [*(site.results / name for name in results), *(Path(n) if n else None for n in named)]
    contents = [
        [str(path), hashlib.sha256(path.read_bytes()).hexdigest()]
        if path and path.is_file()
        else [str(path), ""]
        for path in paths
    ]
    contents += [[name, plan.model_dump_json()] for name, plan in plans.items()]
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()[:16]


@contextmanager
def saving(
    project: Project, stem: str, part: Part, version: str | None = None
) -> Iterator[SiteFolder]:
    """A site whose files nobody else changes within the block.

    Parameters
    ----------
    version : `site_version` of what the caller was shown; None: it rests on nothing.

    Raises
    ------
    OutdatedError : it was shown something else.
    """
    with _saving:
        site = project.site(stem)
        if version is not None and version != site_version(site, part):
            raise OutdatedError(
                "its files have changed meanwhile, so nothing was saved",
                where=f"site {stem}",
                hint="open the plan again"
                if part == "plans"
                else "reload the page; what you have not saved stays",
            )
        yield site


def save_beside(
    project: Project,
    site: SiteFolder,
    section: str,
    files: dict[str, Writer],
    named: dict[str, str | None],
    along: dict[str, str] | None = None,
) -> list[str]:
    """Write files into the site's folder and name them in a section of the site file.

    Parameters
    ----------
    files : how to write each, by its name. named : key in the section and the file's name; None
        removes the key, and the file if the studio had written it. along : files that no key names,
        and the key with whose file each goes.

    Returns
    -------
    files that were written, relative to the project

    Raises
    ------
    InputError : a path leads outside the project, the site file cannot be changed so, or a file is
        there that it does not name; nothing is written then.
    """
    with _saving:
        return _save(project, site, section, files, named, along or {})


def _save(
    project: Project,
    site: SiteFolder,
    section: str,
    files: dict[str, Writer],
    named: dict[str, str | None],
    along: dict[str, str],
) -> list[str]:
    text = project.inside(site.resolved.file).read_bytes().decode()
    for key, name in named.items():
        text = with_value(text, section, key, name and f"{site.stem}/{name}")
    folder = site.resolved.file.parent / site.stem
    own = _own_files(project, site, section)
    own |= {name: own[key].with_name(name) for name, key in along.items() if key in own}
    changed = write_site(project, site, text, files, {*own.values()})
    for key, name in named.items():
        if name is None and key in own and own[key] == project.inside(folder / _NAMES.get(key, "")):
            _remove(own[key], site)
    return changed


def write_site(
    project: Project, site: SiteFolder, text: str, files: dict[str, Writer], own: set[Path]
) -> list[str]:
    """Write a site file and files in the site's folder, within a block of `saving`.

    Parameters
    ----------
    text : of the site file. files : how to write each, by its name. own : absolute paths that the
        site file names already.

    Returns
    -------
    files that changed, relative to the project

    Raises
    ------
    InputError : as `save_beside`; nothing is written then.
    """
    site_file = project.inside(site.resolved.file)
    resolve_site(yaml.safe_load(text), site.resolved.file, project.config())
    folder = site.resolved.file.parent / site.stem
    paths = {project.inside(folder / name): write for name, write in files.items()}
    contents = {path: _content(path.name, write) for path, write in paths.items()}
    contents[site_file] = text.encode()
    changed = [path for path, content in contents.items() if not _holds(path, content)]
    _check_own({*changed} - {site_file, *own})
    for path in changed:
        _write(path, contents[path])
    return [str(path.relative_to(project.root)) for path in changed]


def _remove(path: Path, site: SiteFolder) -> None:
    """Remove a file, unless a plan names it, too."""
    plans = site.resolved.plans.values()
    named = {Path(file).resolve() for p in plans for option in FILES if (file := p.file_of(option))}
    if path not in named:
        path.unlink(missing_ok=True)


def _own_files(project: Project, site: SiteFolder, section: str) -> dict[str, Path]:
    """Files within the project that the site file names, by key."""
    keys = {key for place, found, _ in _FILES.values() if place == section for key in found}
    named = {key: site.resolved.beside(_named(site, section, key)) for key in keys}
    paths = {key: (project.root / path).resolve() for key, path in named.items() if path}
    return {key: path for key, path in paths.items() if path.is_relative_to(project.root)}


def _named(site: SiteFolder, section: str, key: str) -> str | None:
    name: str | None = getattr(getattr(site.resolved.site, section), key)
    return name


def _check_own(foreign: set[Path]) -> None:
    """Refuse to overwrite what somebody else put there."""
    for path in sorted(foreign):
        if path.exists():
            raise InputError(
                "is there already, and the site file does not name it",
                where=str(path),
                hint="move it away, or name it in the site file",
            )


def _content(name: str, write: Writer) -> bytes:
    """What a writer writes; under the file's own name, which some formats keep."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


def _write(path: Path, content: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
