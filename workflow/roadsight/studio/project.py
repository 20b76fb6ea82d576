"""The project that the studio shows: its sites, their files, and nothing outside its folder."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roadsight.base.errors import InputError
from roadsight.base.texts import read_yaml
from roadsight.config.load import SITES, ResolvedSite, load_config, load_site
from roadsight.config.schema import Config
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json

CONFIG = Path("config/config.yaml")
# Files that the scene's steps leave in a site's results.
FRAME = "scene/frame.json"
CLOUD = "scene/cloud.parquet"
GROUND = "scene/ground.parquet"
DEM = "scene/dem.tif"


def find_project(folder: Path) -> Path:
    """The project's root: the folder or one above it.

    Raises
    ------
    InputError : there is no roadsight project.
    """
    start = folder.resolve()
    for place in (start, *start.parents):
        if (place / CONFIG).is_file() and (place / "Snakefile").is_file():
            return place
    raise InputError(
        "is not inside a roadsight project",
        where=str(start),
        allowed="a folder with Snakefile",
        hint="go to the project's folder, or name it with --folder",
    )


def _state(path: Path) -> tuple[object, ...]:
    """What changes with a file, also where it is replaced within one tick of the clock."""
    about = path.stat()
    return path, about.st_mtime_ns, about.st_ino, about.st_size


@dataclass(frozen=True)
class SiteFolder:
    """A site with its results.

    Parameters
    ----------
    stem : name of its file in config/sites. resolved : its settings. results : its results.
    """

    stem: str
    resolved: ResolvedSite
    results: Path

    def file(self, name: str) -> Path:
        """Path of a result that must be there.

        Raises
        ------
        InputError : it is not there yet.
        """
        path = self.results / name
        if not path.exists():
            raise InputError(
                f"{path} is not there yet",
                where=f"site {self.stem}",
                hint=f"run the workflow first: {self.command}",
            )
        return path

    @property
    def command(self) -> str:
        """How to make its results."""
        return f"snakemake --cores 2 --config 'sites=[{self.stem}]'"

    def frame(self) -> Frame:
        """Its local frame."""
        return Frame.from_dict(read_json(self.file(FRAME)))


class Project:
    """A project on disk; the process stands in its root, since its settings name files from there.

    Attributes
    ----------
    root : absolute, without links.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self._known: dict[str, tuple[object, SiteFolder]] = {}

    def config(self) -> Config:
        """Settings of the project.

        Raises
        ------
        InputError : config/config.yaml is broken.
        """
        return load_config(read_yaml(CONFIG), str(CONFIG))

    def stems(self) -> list[str]:
        """Names of all site files, those that the configuration runs first."""
        found = sorted(path.stem for path in SITES.glob("*.yaml"))
        try:
            first = [name for name in self.config().sites if name in found]
        except InputError:
            first = []
        return [*first, *(name for name in found if name not in first)]

    def site(self, stem: str) -> SiteFolder:
        """A site by the name of its file.

        Raises
        ------
        InputError : no such site, or something is wrong with its file.
        """
        file = SITES / f"{stem}.yaml"
        if file not in SITES.glob("*.yaml"):
            raise InputError("no such site", where="studio", found=stem)
        state = [_state(path) for path in (*CONFIG.parent.glob("*.yaml"), file)]
        known = self._known.get(stem)
        if known is None or known[0] != state:
            resolved = load_site(stem, self.config())
            known = state, SiteFolder(stem, resolved, Path("results") / resolved.site.site)
            self._known[stem] = known
        return known[1]

    def inside(self, path: str | os.PathLike[str]) -> Path:
        """Absolute path, links followed, of what the studio may write.

        Raises
        ------
        InputError : it lies outside the project.
        """
        found = (self.root / path).resolve()
        if not found.is_relative_to(self.root) or found == self.root:
            raise InputError(
                "lies outside the project, so the studio does not write it", where=str(path)
            )
        return found

    def named(self, path: str | os.PathLike[str]) -> Path:
        """Absolute path of what the studio may show: a name inside the project, perhaps a link.

        Raises
        ------
        InputError : the name leads outside the project.
        """
        found = Path(os.path.normpath(self.root / path))
        if not found.is_relative_to(self.root):
            raise InputError("lies outside the project, so it is not shown", where=str(path))
        return found

    def overview(self) -> dict[str, Any]:
        """Sites with what is there of each, and what is broken."""
        try:
            configured, broken = self.config().sites, ""
        except InputError as error:
            configured, broken = [], str(error)
        return {
            "name": self.root.name,
            "id": hashlib.sha256(str(self.root).encode()).hexdigest()[:12],
            "broken": broken,
            "configured": configured,
            "sites": [self._described(stem) for stem in self.stems()],
        }

    def _described(self, stem: str) -> dict[str, Any]:
        about: dict[str, Any] = {"stem": stem, "title": stem, "jobs": [], "error": ""}
        try:
            site = self.site(stem)
        except InputError as error:
            return about | {"error": str(error)}
        chosen = site.resolved.site
        there = {
            "cloud": CLOUD,
            "candidates": "placement/round-0/candidates.parquet",
            "cameras": "poles/frames.parquet",
            "poles": "poles/poles.parquet",
            "summary": "summary.json",
        }
        return about | {
            "title": chosen.title or chosen.site,
            "jobs": chosen.jobs,
            "command": site.command,
            "plans": {name: plan.title for name, plan in site.resolved.plans.items()},
            "there": {name: (site.results / file).exists() for name, file in there.items()},
        }
