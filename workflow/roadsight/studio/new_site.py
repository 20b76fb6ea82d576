"""A site from a cloud on this machine, as `roadsight init` makes it; looked at first."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field

from roadsight.base.errors import InputError
from roadsight.config.load import SITES, resolve_site
from roadsight.config.starter import site_name, start_site
from roadsight.io.records.atomic import atomic_path
from roadsight.studio.project import Project

_SUFFIXES = (".las", ".laz")
_Text = Annotated[str, Field(max_length=4000)]


class CloudBody(BaseModel):
    """A cloud that is to become a site.

    Parameters
    ----------
    path : of the file on this machine. site : name for people; "": that of the file. given : keys
    that the user knows. write : whether to write the site file, or only look.
    """

    model_config = ConfigDict(extra="forbid")
    path: Annotated[_Text, Field(min_length=1)]
    site: Annotated[str, Field(max_length=100)] = ""
    given: dict[Literal["crs", "target_crs", "units", "vertical_units"], _Text] = {}
    write: bool = False


def new_site(project: Project, asked: CloudBody) -> dict[str, Any]:
    """What was found in a cloud, and the site file that it makes.

    Raises
    ------
    InputError : no such cloud, it cannot be read, the site is there already, or a given key is
        wrong; nothing is written then.
    """
    cloud = Path(asked.path.strip().strip('"')).expanduser()
    if cloud.suffix.lower() not in _SUFFIXES or not cloud.is_file():
        raise InputError(
            "is no LAS or LAZ file on this machine", where="cloud", found=str(cloud)[:200]
        )
    title = asked.site.strip() or cloud.stem
    path = SITES / f"{site_name(title)}.yaml"
    if path.exists():
        raise InputError("exists already", where=str(path), hint="choose another name")
    given = {str(key): value for key, value in asked.given.items()}
    starter = start_site([cloud], path, site_name(title), title, given)
    resolve_site(yaml.safe_load(starter.text), path, project.config())
    if asked.write:
        with atomic_path(project.inside(path)) as temporary:
            temporary.write_text(starter.text, encoding="utf-8")
    return {
        "site": starter.name,
        "file": str(path),
        "found": starter.found,
        "assumed": starter.assumed,
        "doubts": starter.doubts,
        "missing": starter.missing,
        "text": starter.text,
        "written": asked.write,
    }
