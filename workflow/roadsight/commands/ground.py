"""``roadsight ground``: label the ground of a cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from roadsight.api.clouds import labels_of, write_labelled
from roadsight.api.scene import ground
from roadsight.base.sections.scene import GroundFilter
from roadsight.commands.verb import CloudPath, Reading, Verb, check_output, load_cloud


def run(
    cloud_path: CloudPath,
    /,
    reading: Reading,
    settings: GroundFilter,
    *,
    out: Annotated[Path, "LAZ or LAS file to write"],
) -> None:
    """Write the cloud with ground labels, all other dimensions kept."""
    check_output(out, cloud_path, ".laz", ".las")
    cloud = load_cloud(cloud_path, reading)
    labels = labels_of(cloud, ground(cloud, settings))
    write_labelled(out, cloud, labels)
    print(f"{(labels == 2).sum()} of {len(labels)} points are ground: {out}")


VERB = Verb("ground", "label ground points (class 2)", run)
