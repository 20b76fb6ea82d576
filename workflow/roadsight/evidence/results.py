"""Finished results of a site, as metrics read them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from roadsight.evidence.exact_highway import ExactHighway
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.placement.sensors.sensors import AnySensor


@dataclass(frozen=True)
class Results:
    """Finished results of a site, and of the same site at its base settings.

    Parameters
    ----------
    folder, base : ``results/<site>`` of the two. seed, length_m : of the generated scene.
    plan : the plan that is looked at. sensors : definitions of its sensors, of all kinds.
    stride : only every so many azimuths of the spinning ones are simulated.
    """

    folder: Path
    base: Path
    seed: int
    length_m: float
    plan: str
    sensors: dict[str, AnySensor]
    stride: int = 1

    @property
    def frame(self) -> Frame:
        """Local frame."""
        return Frame.from_dict(read_json(self.folder / "scene/frame.json"))

    @property
    def scene(self) -> ExactHighway:
        """The exact scene."""
        return ExactHighway(self.seed, self.length_m, self.frame)

    def tables(self, pattern: str) -> pd.DataFrame:
        """Tables whose names match a pattern, one below the other."""
        return pd.concat([read_table(path) for path in sorted(self.folder.glob(pattern))])
