"""``roadsight pavement``: label the ground and the road of a cloud."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from roadsight.api.clouds import Cloud, labels_of, write_labelled
from roadsight.api.scene import IntensityUse, Method, ground, pavement
from roadsight.base import SEED
from roadsight.base.arrays import Bools
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Pavement
from roadsight.commands.verb import CloudPath, Reading, Verb, check_output, load_cloud
from roadsight.io.vector.known import read_seeds, read_track
from roadsight.scene.whole import FoundRoad


@dataclass(frozen=True)
class Search:
    """How the pavement is looked for."""

    method: Annotated[Method, Pavement]
    intensity: Annotated[IntensityUse, Pavement]
    engine: Annotated[Engine, "published: who computes normals, FPFH and clusters"] = OWN
    seed: Annotated[int, "of the random sample of FPFH"] = SEED
    seeds: Annotated[str, "places on the road, x,y;x,y as in the cloud: surface"] = ""
    track: Annotated[str | None, "line file, where a vehicle drove: surface"] = None

    def check(self) -> None:
        """Refuse places on the road with a method that has no use for them.

        Raises
        ------
        InputError : ``--seeds`` or ``--track`` with ``--method published``.
        """
        given = [f"--{name}" for name in ("seeds", "track") if getattr(self, name)]
        if given and self.method == "published":
            raise InputError(
                "have no use in this method",
                where=" and ".join(given),
                found="--method published",
                allowed="--method surface or auto",
                hint="leave them out, or let the surface grow from them",
            )

    def given(self) -> list[str]:
        """Options that differ from their defaults."""
        usual = Search(Pavement().method, Pavement().intensity)
        changed = (name for name, value in vars(self).items() if value != getattr(usual, name))
        return [f"--{name}" for name in changed]

    def road(self, cloud: Cloud, labelled: Bools | None = None) -> FoundRoad:
        """The pavement of a cloud, whose ground may be known.

        Raises
        ------
        InputError : as `pavement`, `read_seeds` and `read_track`.
        """
        return pavement(
            cloud,
            method=self.method,
            intensity=self.intensity,
            ground=labelled,
            seed=self.seed,
            seeds_xy=read_seeds(self.seeds, cloud.frame, "--seeds"),
            track_xy=read_track(self.track, cloud.frame),
            engine=self.engine,
        )


def run(
    cloud_path: CloudPath,
    /,
    reading: Reading,
    search: Search,
    *,
    out: Annotated[Path, "LAZ or LAS file to write"],
) -> None:
    """Write the cloud with ground and road labels, all other dimensions kept."""
    check_output(out, cloud_path, ".laz", ".las")
    search.check()
    cloud = load_cloud(cloud_path, reading)
    labelled = ground(cloud)
    found = search.road(cloud, labelled)
    labels = labels_of(cloud, labelled, found.points)
    write_labelled(out, cloud, labels)
    print(
        f"{found.outline.area:.0f} m2 of pavement in {len(found.outline.geoms)} parts,"
        f" {(labels == 11).sum()} points: {out}"
    )


VERB = Verb("pavement", "label road (class 11) and other ground (class 2)", run)
