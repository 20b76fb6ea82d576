"""Kinds of objects beside the road: what shows them in a mask, and how large they are.

Poles end at the ground, and the lower end of their mask is where they stand. A sign's panel does
not: its lower edge is as high as a person, and a ray through it meets the ground several times as
far away. Crowns that touch have no outlines of their own in an image, and rails run through many
images: both are looked for in the cloud, and images confirm them. So are buildings and headwalls,
where the cloud's classes tell them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

Shape = Literal["stem", "panel", "crown", "line", "block"]


class PixelClass(IntEnum):
    """What a pixel shows, whatever the network's own labels are."""

    OTHER = 0
    ROAD = 1
    MARKING = 2
    KERB = 3
    POLE = 4
    SIGN = 5
    VEGETATION = 6
    BUILDING = 7
    VEHICLE = 8
    SKY = 9
    GUARDRAIL = 10
    TREE = 11
    WIRE = 12


@dataclass(frozen=True)
class ObjectKind:
    """Limits of one kind; px of an image 1200 px high.

    Parameters
    ----------
    classes : pixel classes. shape : "stem", which ends at the ground; "panel", held up by something
    else; "crown", "line" and "block", which the cloud parts.
    height_px : lower ones are dropped, None: by the setting for poles. height_m : heights above
    ground that an object of the cloud may have. area_m2 : areas in plan of a block.
    size_m, size_sigma : square root of a panel's area,
    and one standard deviation of its logarithm: they tell its distance roughly. clearance_m : what
    stands nearer to road or building is withheld, None: by the setting. instead : classes that,
    shown at its place, speak against an object of the cloud; others may hide it. needs_mask :
    whether an image must show it: its shape in the cloud alone does not tell what it is.
    """

    classes: tuple[PixelClass, ...]
    shape: Shape
    height_px: float | None = None
    height_m: tuple[float, float] = (0.0, float("inf"))
    area_m2: tuple[float, float] = (0.0, float("inf"))
    size_m: float = float("nan")
    size_sigma: float = float("nan")
    clearance_m: float | None = None
    instead: tuple[PixelClass, ...] = ()
    needs_mask: bool = True

    @property
    def from_cloud(self) -> bool:
        """Whether it is looked for in the cloud and not as a piece of a mask."""
        return self.shape in ("crown", "line", "block")


# Sign: 15 px are 5 px in the sample's images, as which a panel of 0.8 m is seen from 200 m. Speed
# limits and warnings are 0.61 by 0.76 m and 0.76 by 0.76 m in the United States (MUTCD,
# conventional roads), 0.6 to 0.9 m across in Europe; half of the logarithm covers marker boards,
# large signs and panels seen from the side. A panel's edge stands 0.6 m behind a kerb, its post
# 0.9 m: less than that by the error of the road's edge. Tree: lower ones are bushes, which
# vehicles run over. Guardrail: W-beams reach 0.69 to 0.81 m, concrete barriers 0.81 to 1.07 m;
# below 0.35 m is grass. Networks take rails for road, shoulder or vehicles, so that only sky and
# buildings contradict them. Building: what is lower than a garage or smaller than a hut gives way.
# Headwall: from a kerb's height, which stops a wheel, to the wall of a large culvert; grass hides
# it in images, so that only sky contradicts.
KINDS = {
    "pole": ObjectKind((PixelClass.POLE,), "stem"),
    "sign": ObjectKind(
        (PixelClass.SIGN,), "panel", height_px=15.0, size_m=0.7, size_sigma=0.5, clearance_m=0.3
    ),
    "tree": ObjectKind(
        (PixelClass.TREE,),
        "crown",
        height_m=(3.0, 60.0),
        instead=(PixelClass.SKY, PixelClass.ROAD, PixelClass.MARKING, PixelClass.BUILDING),
    ),
    "guardrail": ObjectKind(
        (PixelClass.GUARDRAIL,),
        "line",
        height_m=(0.35, 1.1),
        instead=(PixelClass.SKY, PixelClass.BUILDING),
        needs_mask=False,
    ),
    "building": ObjectKind(
        (PixelClass.BUILDING,),
        "block",
        height_m=(2.0, 500.0),
        area_m2=(4.0, float("inf")),
        clearance_m=float("-inf"),
        instead=(PixelClass.SKY, PixelClass.ROAD, PixelClass.MARKING),
        needs_mask=False,
    ),
    "headwall": ObjectKind(
        (PixelClass.BUILDING,),
        "block",
        height_m=(0.2, 5.0),
        area_m2=(0.0, 60.0),
        clearance_m=float("-inf"),
        instead=(PixelClass.SKY,),
        needs_mask=False,
    ),
}
