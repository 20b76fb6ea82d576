"""What verbs on a cloud take, and how they read it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from roadsight.api.clouds import Cloud, read_cloud
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Overlap, Scene
from roadsight.geometry.reference import UnitChoice
from roadsight.io.vector.layer_names import split_layer

CloudPath = Annotated[Path, "LAS or LAZ file"]  # the cloud of a verb


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
