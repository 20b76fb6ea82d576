"""Schema of the poses in which sensors are tried at each candidate."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from roadsight.base.section import Section

Yaw = Annotated[float, Field(ge=-180, le=180)]
Pitch = Annotated[float, Field(ge=-90, le=90)]
Angles = Annotated[list[Yaw], Field(min_length=1, max_length=72)]
Pitches = Annotated[list[Pitch], Field(min_length=1, max_length=36)]


class PoseGrid(Section):
    """Angles of one kind of sensor, degrees, of which every combination is tried."""

    yaw_deg: Angles = Field(description="from the road's normal, to the left")
    pitch_deg: Pitches = Field(description="upwards")
    roll_deg: Angles = Field(description="right side up")


def _grid(yaw_deg: list[float], pitch_deg: list[float]) -> PoseGrid:
    return PoseGrid(yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=[0.0])


class Poses(Section):
    """Poses tried at each candidate: yaw to the left of the road's normal, pitch up, roll."""

    spinning: PoseGrid = Field(
        default=_grid([0.0], [0.0]),
        description="spinning LiDARs; all angles 0: as mounted, with depth maps of their own",
    )
    rosette: PoseGrid = Field(
        default=_grid([-70.0, -35.0, 0.0, 35.0, 70.0], [-45.0, -25.0, -10.0]),
        description="non-repetitive solid-state LiDARs",
    )
    camera: PoseGrid = Field(
        default=_grid([-70.0, -35.0, 0.0, 35.0, 70.0], [-45.0, -25.0, -10.0]),
        description="cameras",
    )
    radar: PoseGrid = Field(
        default=_grid([-70.0, -35.0, 0.0, 35.0, 70.0], [-20.0, -10.0, -5.0]),
        description="radars",
    )
    panorama_step_deg: float = Field(
        default=0.2, ge=0.02, le=2, description="beams of the depth map that judges poses, degrees"
    )
