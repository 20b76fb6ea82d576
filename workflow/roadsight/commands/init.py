"""``roadsight init``: a commented starter site file from what is found in the clouds."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb
from roadsight.config.load import SITES
from roadsight.config.starter import site_name, start_site
from roadsight.io.records.atomic import atomic_path


def run(
    clouds: Annotated[Sequence[Path], "LAS or LAZ file"],
    /,
    site: Annotated[str | None, "name of the site; by default that of the first cloud"] = None,
    force: Annotated[bool, "overwrite an existing site file"] = False,
    *,
    out: Annotated[Path | None, "site file to write (default: config/sites/NAME.yaml)"] = None,
) -> None:
    """Write the site file and say what is left to fill in.

    Raises
    ------
    InputError : a cloud cannot be read, or the site file exists already.
    """
    name = site_name(site) if site else site_name(clouds[0].stem, str(clouds[0]))
    path = out or SITES / f"{name}.yaml"
    if path.exists() and not force:
        raise InputError("exists already", where=str(path), hint="choose another, or add --force")
    title = site or clouds[0].stem
    starter = start_site(clouds, path, name, title)
    with atomic_path(path) as temporary:
        temporary.write_text(starter.text, encoding="utf-8")
    print(f"wrote {path}")
    _tell("Found", starter.found)
    _tell("Assumed", [f"{key}: {comment}" for key, comment in starter.assumed.items()])
    _tell("To doubt", starter.doubts)
    for key, comment in starter.missing.items():
        print(f"fill in {key}: {comment}")
    within = path.resolve().parent == SITES.resolve() and path.suffix == ".yaml"
    asked = f"--config 'sites=[{path.stem if within else path}]'"
    print(f"{'Then see' if starter.missing else 'See'} what would run:  snakemake -n {asked}")
    print(f"Run it:  snakemake --cores 2 {asked}")


def _tell(heading: str, sentences: Sequence[str]) -> None:
    if sentences:
        print(f"{heading}:")
        for sentence in sentences:
            print(textwrap.fill(sentence, 96, initial_indent="  ", subsequent_indent="    "))


VERB = Verb("init", "write a starter site file for clouds", run)
