"""Finished results of a site, as metrics read them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from roadsight.base.sections.run import Sample
from roadsight.config.schema import Settings
from roadsight.evidence.exact_highway import ExactHighway
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.placement.sensors.sensors import AnySensor
from roadsight_worlds.highway.highway import build_highway


@dataclass(frozen=True)
class Results:
    """Finished results of a site, and of the same site at its base settings.

    Parameters
    ----------
    folder, base : ``results/<site>`` of the two. settings : of the first.
    sample : the generated scene. plan : the plan that is looked at.
    sensors : definitions of its sensors, of all kinds.
    """

    folder: Path
    base: Path
    settings: Settings
    sample: Sample
    plan: str
    sensors: dict[str, AnySensor]

    @property
    def frame(self) -> Frame:
        """Local frame."""
        return Frame.from_dict(read_json(self.folder / "scene/frame.json"))

    @cached_property
    def scene(self) -> ExactHighway:
        """The exact scene."""
        own = self.sample
        highway = build_highway(
            self.settings.seed, own.length_m, own.radius_m, own.grade, own.tunnel, own.overhead
        )
        return ExactHighway(highway, self.frame)

    def tables(self, pattern: str) -> pd.DataFrame:
        """Tables whose names match a pattern, one below the other."""
        return pd.concat([read_table(path) for path in sorted(self.folder.glob(pattern))])
