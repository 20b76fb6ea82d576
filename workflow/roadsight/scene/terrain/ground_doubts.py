"""What limits the worth of ground labels and of the terrain model made from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.base.doubts import Doubt

_LEAST_GROUND = 0.2
"""Share of ground below which streets and corridors are unusual: dense forest, or a lost road."""
_MOST_FILLED = 0.3
"""Share of filled cells in the scanned area beyond which heights rest on what lies around."""
_MOST_NOISE_M = 0.05
"""Thickest layer of ground; on flat planes with more noise, the filter was not held to 3 %."""
_HIGH_M = 2.0
"""No ground stands this high above the terrain model."""
_MOST_HIGH = 0.03
"""Share of a file's ground points that stand so high from which its classes mean nothing: published
ones have 0 to 0.06 %; where all points were of class 2, streets had 7 to 8 %, tiles 12 to 60."""
_MOST_DISAGREE = 0.15
"""Published classifications disagree with the filter on 0.5 to 1.5 % of the points, generated ones
with tall grass on 6 %."""
_GROUND_CLASSES = (2, 11)
_UNCLASSIFIED = (0, 1)


@dataclass
class ClassAgreement:
    """The file's ground classes beside ours, counted tile by tile."""

    points: int = 0
    disagree: int = 0
    own_ground: int = 0
    high: int = 0

    def add(self, classes: Bytes, ground: Bools, above_m: Floats) -> None:
        """Count points.

        Parameters
        ----------
        classes : (n,) of the file. ground : (n,) ours. above_m : (n,) above the terrain model, NaN
            where it has no height.
        """
        own = np.isin(classes, _GROUND_CLASSES)
        told = ~np.isin(classes, _UNCLASSIFIED)
        self.points += int(told.sum())
        self.disagree += int((own != ground)[told].sum())
        self.own_ground += int(own.sum())
        self.high += int((own & (above_m > _HIGH_M)).sum())


def ground_doubts(
    ground_share: float, filled_share: float, noise_m: float, classes: ClassAgreement
) -> list[Doubt]:
    """Doubts about a site's ground.

    Parameters
    ----------
    ground_share : of the points. filled_share : of the cells of the terrain model inside the
        scanned area. noise_m : median thickness (one sigma) of the ground's layer, NaN if unknown.
    """
    found = [
        Doubt("ground_share", "note", "share of points on the ground", round(ground_share, 4)),
        Doubt("dem_filled", "note", "share of filled cells of the DEM", round(filled_share, 4)),
    ]
    if ground_share < _LEAST_GROUND:
        found[0] = Doubt(
            "ground_share",
            "doubt",
            "few points lie on the ground: look whether the road is among them",
            round(ground_share, 4),
            _LEAST_GROUND,
        )
    if filled_share > _MOST_FILLED:
        found[1] = Doubt(
            "dem_filled",
            "doubt",
            "much of the terrain model is filled from around, not measured",
            round(filled_share, 4),
            _MOST_FILLED,
        )
    if noise_m > _MOST_NOISE_M:
        text = "the ground is a thick layer (registration?): kerbs and low objects drown in it, m"
        found.append(Doubt("layer_noise", "doubt", text, round(noise_m, 4), _MOST_NOISE_M))
    return found + _class_doubts(classes)


def _class_doubts(classes: ClassAgreement) -> list[Doubt]:
    """Doubts about the classes of the file; one without ground classes says nothing."""
    if not classes.own_ground:
        return []
    high = classes.high / classes.own_ground
    if high > _MOST_HIGH:
        text = f"points that the file calls ground stand over {_HIGH_M:g} m above the terrain"
        return [Doubt("classes_contradict", "doubt", text, round(high, 4), _MOST_HIGH)]
    disagree = classes.disagree / classes.points
    if disagree > _MOST_DISAGREE:
        text = "the file's ground classes disagree with the ground that was found"
        return [Doubt("classes_disagree", "doubt", text, round(disagree, 4), _MOST_DISAGREE)]
    return []


def raised_settings(asked: Mapping[str, float], used: Mapping[str, float]) -> list[Doubt]:
    """A note for each setting that was raised because the points are too far apart for it."""
    return [
        Doubt(
            f"raised_{name}",
            "note",
            f"{name} was raised from {value:g} to {used[name]:.3g}: the points are sparser",
            used[name],
            value,
        )
        for name, value in asked.items()
        if used[name] > value
    ]
