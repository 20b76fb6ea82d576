"""What the pole study's alignment reads: raw edge points, all edge pixels, lines of travel."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.sections.poles import AlignmentLimits
from roadsight.geometry.cameras import wrap_deg
from roadsight.io.records.tables import read_table
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.published import (
    FARTHEST_M,
    NEAREST_M,
    Axes,
    Edges,
    by_row,
    nelder_mead,
    pose_in,
    start_of,
    whole_pixels,
)
from roadsight.poles.alignment.track import sides_of_track
from roadsight.poles.calibration.calibration_table import DriveCalibration
from roadsight.poles.drive.track import moving
from roadsight.poles.images.lanes import scale_of
from roadsight.stages.poles.shared.alignment_inputs import AlignmentScene, SceneFiles

_BEHIND_DEG = 90.0
"""Edge points that far off the line of travel or farther are not used (authors' code)."""


class PublishedScene:
    """Images of all routes as the pole study aligns them.

    Of the site's road edges the points themselves are used, not lines through them, and of the
    images all edge pixels.
    """

    def __init__(self, files: SceneFiles, scene: AlignmentScene) -> None:
        self._scene = scene
        self._xyz_m = read_table(files.road_edges, ["x", "y", "z"]).to_numpy(np.float64)
        self._tree = cKDTree(self._xyz_m[:, :2])
        self._ahead: dict[str, tuple[int, Floats | None]] = {}
        for route in dict.fromkeys(place.route for place in scene.places):
            own = [place for place in scene.places if place.route == route]
            own.sort(key=lambda place: place.station_m)
            ways = ways_ahead(np.array([_origin(place) for place in own]))
            for number, (place, way) in enumerate(zip(own, ways, strict=True)):
                self._ahead[place.image] = number, way

    def row(self, place: Place, drive: DriveCalibration, limits: AlignmentLimits) -> dict[str, Any]:
        """Row of one image; one that is not aligned keeps the baseline."""
        number, way = self._ahead[place.image]
        size = place.start.width_px, place.start.height_px
        about: dict[str, Any] = {"width_px": size[0], "height_px": size[1]}
        about |= {"cx_px": (size[0] - 1) / 2, "cy_px": (size[1] - 1) / 2}
        start, focal_px = start_of(drive.mount.mean)
        about |= {"focal_px": focal_px, "landmarks": 0, "edge_points": 0, "one_sided": False}
        about |= {"residual_px": float("nan"), "accepted": False}
        if way is None:
            heading = {"heading_deg": place.start.heading_deg, "pitch_deg": 0.0, "roll_deg": 0.0}
            position = dict(zip("xyz", _origin(place).tolist(), strict=True))
            return about | position | heading | {"reason": "no next image gives the direction"}
        axes = Axes.along(_origin(place), way)
        edges = self._edges(place, axes, pose_in(axes, start))
        about["edge_points"] = sum(map(len, edges.points_ft))
        about["one_sided"] = any(not len(pixels) for pixels in edges.pixels)
        if not sum(map(len, edges.pixels)):
            return about | pose_in(axes, start) | {"reason": "no edges in the image"}
        if not about["edge_points"]:
            return about | pose_in(axes, start) | {"reason": "no road edges ahead"}
        bounds = (limits.bound_m, limits.bound_deg)
        parameters, cost = nelder_mead(edges, start, focal_px, number, bounds)
        about["residual_px"] = float(scale_of(size[1]) * np.sqrt(cost / 2.0))
        return about | pose_in(axes, parameters) | {"accepted": True, "reason": ""}

    def _edges(self, place: Place, axes: Axes, baseline: dict[str, float]) -> Edges:
        """Edges of one image, without the points that the terrain hides from the baseline."""
        near = np.array(sorted(self._tree.query_ball_point(axes.origin_m[:2], FARTHEST_M)), int)
        offset = self._xyz_m[near] - axes.origin_m
        ahead = -axes.rotation[2]
        turn = np.degrees(np.arctan2(offset[:, 0], offset[:, 1]) - np.arctan2(ahead[0], ahead[1]))
        far = np.hypot(offset[:, 0], offset[:, 1]) > NEAREST_M
        xyz_m = self._xyz_m[near[far & (np.abs(wrap_deg(turn)) < _BEHIND_DEG)]]
        if self._scene.visible is not None:
            eye = np.array([baseline[axis] for axis in "xyz"])
            xyz_m = xyz_m[self._scene.visible(eye, xyz_m)]
        side = sides_of_track(xyz_m, place.track_m)
        rows = self._scene.pixels.get(place.image)
        uv, sign = np.empty((0, 2)), np.empty(0)
        if rows is not None:
            uv, sign = whole_pixels(rows[["u", "v"]]), rows["side"].to_numpy()
        return Edges(
            (axes.feet(xyz_m[side < 0]), axes.feet(xyz_m[side > 0])),
            (by_row(uv[sign < 0]), by_row(uv[sign > 0])),
            (place.start.width_px, place.start.height_px),
        )


def ways_ahead(xyz_m: Floats) -> list[Floats | None]:
    """From each place (n, 3) of a route to the next one to which the vehicle moved.

    The last ones take the way before; there is none where the vehicle never moves.
    """
    nodes = moving(xyz_m[:, :2])
    if len(nodes) < 2:
        return [None] * len(xyz_m)
    ways = np.diff(xyz_m[nodes], axis=0)
    node = np.searchsorted(nodes, np.arange(len(xyz_m)), side="right") - 1
    return list(ways[np.minimum(node, len(ways) - 1)])


def _origin(place: Place) -> Floats:
    return np.array([place.start.x_m, place.start.y_m, place.start.z_road_m])
