"""What verbs of ``roadsight`` are made of: typed functions, and what those on a cloud take."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from roadsight.api.clouds import Cloud, read_cloud
from roadsight.base.errors import InputError
from roadsight.base.options import add_options, called
from roadsight.base.sections.scene import Overlap, Scene
from roadsight.geometry.reference import UnitChoice
from roadsight.io.records.companions import split_layer

CloudPath = Annotated[Path, "LAS or LAZ file"]  # the cloud of a verb


@dataclass(frozen=True)
class Verb:
    """A verb of the command line.

    Parameters
    ----------
    about : what it does, one line. run : does it; its parameters are the options.
    """

    name: str
    about: str
    run: Callable[..., None]

    def add_to(self, verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
        """Add it to the verbs of a command line."""
        parser = verbs.add_parser(self.name, help=self.about)
        add_options(parser, self.run, may_lack=False)
        parser.set_defaults(run=partial(called, self.run))


@dataclass(frozen=True)
class Reading:
    """How a verb reads its cloud."""

    choice: UnitChoice
    overlap: Annotated[Overlap, Scene]


def check_output(
    out: Path, cloud: Path, *suffixes: str, read: Sequence[Path | str | None] = ()
) -> None:
    """Check the output's name before any work is done.

    Parameters
    ----------
    read : other files that the verb reads, None for those that are not given.

    Raises
    ------
    InputError : it is of another kind, or is one of the files that the verb reads.
    """
    if out.suffix.lower() not in suffixes:
        raise InputError(
            "is no name for what this verb writes",
            where=f"--out {out}",
            allowed=", ".join(suffixes),
        )
    for path in [cloud, *(path for path in read if path)]:
        if out.resolve() == Path(split_layer(path)[0]).resolve():
            raise InputError(
                "would replace a file that the verb itself reads",
                where=f"--out {out}",
                hint="choose another name",
            )


def load_cloud(path: Path, reading: Reading) -> Cloud:
    """The verb's cloud."""
    return read_cloud(path, **vars(reading.choice), overlap=reading.overlap)


def check_positive(values: Mapping[str, float]) -> None:
    """Check numbers that were given as options of these names.

    Raises
    ------
    InputError : one is not positive and finite.
    """
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            flag = f"--{name.replace('_', '-')}"
            raise InputError("is not positive", where=flag, found=value, allowed="more than 0")
