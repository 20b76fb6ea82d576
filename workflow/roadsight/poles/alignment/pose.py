"""Unknowns of a camera on a vehicle, and the pose that they give.

The vehicle is on the road at its track position, in the road's direction, tilted with the road;
further along, the road's direction and grade are those further along.
The camera differs from that by the numbers of ``UNKNOWNS``. One says how far the principal point is
right of the image's middle, or of where its lens is known to have it. Four of them say how far
painted edge lines and road borders lie inside the LiDAR's road edge, the last two how far the side
views are turned from the front view. What a drive shares is among them, so that an image is solved
with what the drive leaves open, and all images together tell what the drive shares.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.geometry.cameras import compass_deg

UNKNOWNS = (
    "along_m", "lateral_m", "height_m", "yaw_deg", "pitch_deg", "roll_deg", "log_focal",
    "cx_shift_px", "lane_inset_left_m", "lane_inset_right_m", "border_inset_left_m",
    "border_inset_right_m", "left_yaw_deg", "right_yaw_deg",
)  # fmt: skip
ALONG, LATERAL, HEIGHT, YAW, PITCH, ROLL, FOCAL, CX, INSETS = range(9)
TURNS = 12  # Number of the first yaw of a side view; between `INSETS` and this are the four insets
_TIMES = [1] * INSETS + [2, 2, 2]  # How many unknowns share a value of `Spread`
SIZE = len(UNKNOWNS)  # How many unknowns there are


@dataclass(frozen=True)
class Start:
    """Where the track says that the vehicle is.

    Parameters
    ----------
    x_m, y_m : track position, local metres. z_road_m : height of the road there.
    heading_deg : direction of travel, clockwise from grid north.
    grade : rise per metre ahead. bank : rise per metre to the right.
    bend : turn of the road to the right, radians per metre. hump : change of the grade per metre.
    width_px, height_px, cx_px, cy_px : of the image.
    """

    x_m: float
    y_m: float
    z_road_m: float
    heading_deg: float
    grade: float
    bank: float
    width_px: int
    height_px: int
    cx_px: float
    cy_px: float
    bend: float = 0.0
    hump: float = 0.0

    def vector(self, origin_m: Floats) -> Floats:
        """What the kernel needs, relative to an origin, so that large coordinates lose nothing."""
        x, y, z = origin_m
        heading = np.radians(self.heading_deg)
        return np.array(
            [
                self.x_m - x,
                self.y_m - y,
                self.z_road_m - z,
                heading,
                np.arctan(self.grade),
                np.arctan(self.bank),
                self.cx_px,
                self.cy_px,
                self.grade,
                self.bank,
                self.bend,
                self.hump,
            ]
        )


@dataclass(frozen=True)
class Pose:
    """Camera in the local frame; angles as in `geometry.cameras`."""

    x_m: float
    y_m: float
    z_m: float
    heading_deg: float
    pitch_deg: float
    roll_deg: float
    focal_px: float
    cx_px: float

    @property
    def position_m(self) -> Floats:
        """Camera centre (3,), local metres."""
        return np.array([self.x_m, self.y_m, self.z_m])


def pose_of(start: Start, unknowns: Floats) -> Pose:
    """Camera pose of the unknowns (SIZE,)."""
    along, lateral, height, yaw, pitch, roll, log_focal, cx_shift = unknowns[:INSETS]
    heading = np.radians(start.heading_deg)
    return Pose(
        start.x_m + along * np.sin(heading) + lateral * np.cos(heading),
        start.y_m + along * np.cos(heading) - lateral * np.sin(heading),
        start.z_road_m + start.grade * along + start.bank * lateral + height,
        float(compass_deg(start.heading_deg + np.degrees(start.bend * along) + yaw)),
        float(np.degrees(np.arctan(start.grade) + start.hump * along) + pitch),
        float(np.degrees(np.arctan(start.bank)) + roll),
        float(np.exp(log_focal)),
        float(start.cx_px + cx_shift),
    )


@dataclass(frozen=True)
class Spread:
    """One standard deviation of what changes from image to image, about the drive's mean.

    Defaults: GPS error of about 1 m; a vehicle on its springs on a road whose edges a raster
    knows to a few centimetres in height. Lens and views do not change.
    """

    along_m: float = 1.0
    lateral_m: float = 1.0
    height_m: float = 0.07
    yaw_deg: float = 0.5
    pitch_deg: float = 0.5
    roll_deg: float = 0.3
    log_focal: float = 0.0002
    cx_shift_px: float = 0.02
    lane_inset_m: float = 0.10
    border_inset_m: float = 0.10
    side_yaw_deg: float = 0.002

    def vector(self) -> Floats:
        """Standard deviations in the order of ``UNKNOWNS``."""
        values = [getattr(self, field.name) for field in fields(self)]
        return np.repeat(values, _TIMES)
