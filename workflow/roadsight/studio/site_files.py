"""Files beside a site's settings, and the names of them in the site file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from roadsight.config.load import load_site
from roadsight.errors import InputError
from roadsight.io.atomic import atomic_path
from roadsight.studio.project import Project, SiteFolder
from roadsight.studio.site_text import with_value

Writer = Callable[[Path], Any]


def save_beside(
    project: Project,
    site: SiteFolder,
    section: str,
    files: dict[str, Writer],
    named: dict[str, str | None],
) -> list[str]:
    """Write files into the site's folder and name them in a section of the site file.

    Parameters
    ----------
    files : how to write each, by its name. named : key in the section and the file's name; None
        removes the key.

    Returns
    -------
    files that changed, relative to the project

    Raises
    ------
    InputError : a path leads outside the project, or the site file cannot be changed so.
    """
    before = site.resolved.file.read_text(encoding="utf-8")
    text = before
    for key, name in named.items():
        text = with_value(text, section, key, name and f"{site.stem}/{name}")
    folder, site_file = site.resolved.file.parent / site.stem, project.inside(site.resolved.file)
    paths = {project.inside(folder / name): write for name, write in files.items()}
    changed = [path for path, write in paths.items() if write_if_new(path, write)]
    if text != before:
        write_if_new(site_file, lambda to: to.write_text(text, encoding="utf-8"))
        _check(project, site.stem, site_file, before)
        changed.append(site_file)
    return [str(path.relative_to(project.root)) for path in changed]


def write_if_new(path: Path, write: Writer) -> bool:
    """Write a file unless it holds the same already; whether it changed."""
    with atomic_path(path) as temporary:
        write(temporary)
        return not path.exists() or path.read_bytes() != temporary.read_bytes()


def _check(project: Project, stem: str, site_file: Path, before: str) -> None:
    """Put the site file back if it is not valid any more."""
    try:
        load_site(stem, project.config())
    except InputError:
        site_file.write_text(before, encoding="utf-8")
        raise
