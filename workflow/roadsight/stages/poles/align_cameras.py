"""Pose of every camera of a shard, by road alignment, with its uncertainty or why it has none."""

from __future__ import annotations

import logging
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.doubts import tell_named
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import AlignmentLimits
from roadsight.base.shards import WHOLE, Shard
from roadsight.geometry.cameras import compass_deg, wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import read_cameras
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.alignment.dense import PITCH as DENSE_PITCH
from roadsight.poles.alignment.dense import SIZE, align_dense
from roadsight.poles.alignment.dense import YAW as DENSE_YAW
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.given_cameras import GivenSigma, agreement, camera_row
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import CX, FOCAL, pose_of
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
from roadsight.poles.alignment.solve import Fit, Task
from roadsight.poles.alignment.track import sides_of_track
from roadsight.poles.alignment.verdict import (
    OTHER_THINGS,
    Limits,
    agreeing_landmarks,
    condition,
    dense_doubt,
    edge_doubt,
    heading_turns,
    is_one_sided,
    lost_views,
    moved_by_centre,
    moved_by_focal,
    pose_doubt,
    reached,
    residual_px,
    sigmas,
    too_little,
    with_shared_edges,
)
from roadsight.poles.calibration.calibration import implausible
from roadsight.poles.calibration.calibration_table import DriveCalibration, from_content
from roadsight.poles.drive.videolog import moving
from roadsight.poles.images.views import scale_of
from roadsight.stages.command import Command, logged
from roadsight.stages.poles.shared.alignment_inputs import AlignmentScene, SceneFiles, read_scene
from roadsight.stages.poles.shared.dense_inputs import (
    DenseFiles,
    DenseScene,
    method_of,
    turned_axes,
)

log = logging.getLogger("align_cameras")

BY_HAND = GivenSigma(heading_deg=0.1, pitch_deg=0.1, lateral_m=0.2, along_m=0.5)
"""One standard deviation of a pose that a person set by eye."""

_AROUND = 3.0
"""How many times as far as expected a pose is sought at which edges fit that disagree. On 300 m of
four lanes whose heading the others told 0.4 degrees wrong, this is where all of four images fit."""

_ALONG_M = 0.5
"""Where the others tell the place along the road to this, no landmark of an image need agree. At
the ends of drives (0.6 m and more) such images are 2.5 to 6 px off by the edges of the road."""

CAMERA_COLUMNS = (
    "image",
    "x",
    "y",
    "z",
    "heading_deg",
    "pitch_deg",
    "roll_deg",
    "focal_px",
    "cx_px",
    "cy_px",
    "width_px",
    "height_px",
    "sigma_heading_deg",
    "sigma_pitch_deg",
    "sigma_lateral_m",
    "sigma_along_m",
    "sigma_cx_px",
    "heading_by_cx_deg",
    "sigma_focal_ratio",
    "heading_by_focal_deg",
    "pitch_by_cy_deg",
    "condition",
    "residual_px",
    "edge_points",
    "landmarks",
    "one_sided",
    "accepted",
    "reason",
)

_KINDS: dict[str, type] = {
    **dict.fromkeys(("image", "reason"), str),
    **dict.fromkeys(("accepted", "one_sided"), bool),
    **dict.fromkeys(("width_px", "height_px", "edge_points", "landmarks"), np.int64),
}
"""Of columns that hold no lengths, angles or ratios."""


def align_cameras(
    files: SceneFiles,
    given: DenseFiles,
    accepted: AlignmentLimits,
    calibration: Path,
    corrections: Annotated[str | None, "poses of images set by a person, CSV"] = None,
    shard: Shard = WHOLE,
    *,
    out: Path,
) -> None:
    """Write one row for each usable image of the shard, in the order of the frames."""
    scene = read_scene(files, given.intrinsics)
    drives = {c.key: c for c in map(from_content, read_json(calibration)["drives"])}
    limits = Limits(
        residual_px=accepted.max_residual_px, sigma_heading_deg=accepted.max_sigma_heading_deg
    )
    dealt = shard.dealt(read_table(files.frames, ["image"])["image"])
    own = [p for p in scene.places if p.image in dealt]
    by_hand = read_corrections(corrections, files)
    method = method_of(given.method, bool(scene.lenses))
    dense = DenseScene(files, given, scene.lenses) if method == "dense" else None
    published = PublishedScene(files, scene) if method == "published" else None
    rows: list[dict[str, Any]] = []
    reasons: dict[str, list[str]] = {}
    by_others: list[str] = []
    for place in logged(own, len(own), log, "images"):
        if place.image in by_hand:
            rows.append({"image": place.image, **corrected(scene, place, by_hand[place.image])})
            continue
        key = place.route, place.start.width_px, place.start.height_px
        if key not in drives:
            raise InputError(
                "an image's route and size have no calibration",
                where="calibration",
                found=f"{place.image}: {key}",
                hint="calibrate the drives again",
            )
        drive = drives[key]
        if published is not None:
            row = published.row(place, drive, accepted)
        elif dense is not None:
            row = dense_aligned(dense, place, scene.load(place)(*drive.expected(place)), limits)
        else:
            task = scene.load(place)(*drive.expected(place))
            centre = drive.by_centre(place), drive.sigma_cy_px
            row = aligned(task, method, limits, scene.landmarks, centre)
            if method == "road" and row["accepted"] and not row["edge_points"]:
                by_others.append(place.image)
            if place.image in scene.lenses:
                row["focal_px"] = scene.lenses[place.image].focal_px
        reason = implausible(drive.mount, place.start.width_px)
        if reason and published is None:
            row |= {"accepted": False, "reason": reason}
        rows.append({"image": place.image, **row})
        reasons.setdefault(place.route, []).append(str(row["reason"]))
    table = camera_table(rows)
    for reason, count in sorted(Counter(table["reason"]).items()):
        log.info("%d of %d images: %s", count, len(table), reason or "accepted")
    if by_others:
        log.info(
            "placed by the others of their drive and landmarks if any: %s", ", ".join(by_others)
        )
    for route, stated in sorted(reasons.items()):
        told = log.warning if 2 * sum(map(bool, stated)) > len(stated) else log.info
        told("%s: %s", route, lost_views(stated))
    lost = {route: sum(map(bool, stated)) for route, stated in sorted(reasons.items())}
    write_table(out, table, {"method": method, "lost_views": lost})


def camera_table(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Table of cameras, of the same types where a shard has none."""
    kinds = {name: _KINDS.get(name, np.float64) for name in CAMERA_COLUMNS}
    return pd.DataFrame(rows, columns=list(CAMERA_COLUMNS)).astype(kinds)


def read_corrections(path: str | None, files: SceneFiles) -> dict[str, pd.Series]:
    """Poses that a person set, by image."""
    if not path:
        return {}
    frame = Frame.from_dict(read_json(files.frame))
    table = read_cameras(path, frame)
    told = "corrections are about an image of the videolog"
    known = set(read_table(files.frames, ["image"])["image"])
    tell_named(log, told, set(table["image"]), known, path)
    return {str(row["image"]): row for _, row in table.iterrows()}


def corrected(scene: AlignmentScene, place: Place, pose: pd.Series) -> dict[str, Any]:
    """Row of an image whose pose a person set: taken as it is, and compared with the road."""
    size = place.start.width_px, place.start.height_px
    image_edges, map_edges = scene.edges_of(place)
    return camera_row(
        pose, size, BY_HAND, agreement(pose, size, image_edges, map_edges), len(image_edges.uv_px)
    )


def aligned(
    task: Task,
    method: str,
    limits: Limits,
    noise: LandmarkNoise | None = None,
    centre: tuple[Floats, float] | None = None,
) -> dict[str, Any]:
    """Pose, uncertainty and verdict of one image by the method road or none.

    An image without an alignment keeps the expected pose.

    Parameters
    ----------
    centre : what one standard deviation of the principal point's column moves (k,) in the
    expectation, and that of its row, px; None if known.
    """
    expected = np.asarray(np.linalg.inv(task.prior_information), np.float64)
    nothing = np.full((len(task.image_edges.uv_px), 2), np.nan)
    zero = np.zeros_like(expected), np.zeros(len(expected))
    fit = Fit(task.prior_mean, expected, 0.0, nothing, *zero)
    one_sided = is_one_sided(task)
    reason = "" if method == "none" else too_little(task, limits)
    if method == "road" and not reason:
        task, fits, reason = judged(task, noise, limits)
        fit = fits[0]
    row = _row(task, fit, reason, *(centre or (np.zeros(len(expected)), 0.0)))
    return row | {"one_sided": one_sided}


def judged(task: Task, noise: LandmarkNoise | None, limits: Limits) -> tuple[Task, list[Fit], str]:
    """Minima of an image, the best first, why they are no good, and the task that they are of.

    At a bridge, a driveway's mouth or a parked car the borders of image and cloud are different
    things. Where they disagree, the pose is what the other images of the drive tell, with the
    landmarks of this one. That is so if the others are sure enough by themselves, along the road
    too or with a landmark of this one that agrees, and its edges fit nowhere around either: where
    they do, the others may be wrong. The task that is then returned has no edges.
    """
    fits = locate(task, noise)
    reason = edge_doubt(task, fits[0], limits)
    if reason not in OTHER_THINGS:
        return task, fits, reason or pose_doubt(task, fits, limits)
    others = task.without_edges()
    alone = replace(others, landmarks=None)
    around = replace(task, prior_information=task.prior_information / _AROUND**2)
    told = locate(others, noise, task.prior_mean)
    bare = told if task.landmarks is None else locate(alone, noise, task.prior_mean)
    confirmed = (
        (agreeing_landmarks(others, told[0]) > 0 or sigmas(bare[0], alone)[3] <= _ALONG_M)
        and not pose_doubt(others, told, limits)
        and not pose_doubt(alone, bare, limits)
        and all(edge_doubt(around, fit, limits) in OTHER_THINGS for fit in locate(around, noise))
    )
    return (others, told, "") if confirmed else (task, fits, reason)


def dense_aligned(scene: DenseScene, place: Place, task: Task, limits: Limits) -> dict[str, Any]:
    """Pose, uncertainty and verdict of one image with a known lens.

    An image whose pose is not used keeps the expected one.
    """
    expected = np.asarray(np.linalg.inv(task.prior_information), np.float64)
    own = scene.task(place, task.prior_mean[:SIZE], expected[:SIZE, :SIZE])
    fit = align_dense(own)
    reason = dense_doubt(own, fit, limits)
    pose, covariance = (own.pose, own.covariance) if reason else (fit.pose, fit.covariance)
    # Along and across are those of the track, as everywhere, and not of the camera's view.
    back = turned_axes(place.start.heading_deg - own.pose[DENSE_YAW])
    along, lateral, _, yaw, pitch, _ = np.sqrt(np.diag(back @ covariance @ back.T))
    spread = covariance / np.outer(own.sigma, own.sigma)
    variances = np.linalg.eigvalsh(0.5 * (spread + spread.T))
    return {
        **dict(zip(("x", "y", "z"), map(float, pose[:3]), strict=True)),
        "heading_deg": float(compass_deg(pose[DENSE_YAW])),
        "pitch_deg": float(pose[DENSE_PITCH]),
        "roll_deg": float(pose[DENSE_PITCH + 1]),
        "focal_px": own.lens.focal_px,
        "cx_px": own.lens.cx_px,
        "cy_px": own.lens.cy_px,
        "width_px": place.start.width_px,
        "height_px": place.start.height_px,
        "sigma_heading_deg": float(yaw),
        "sigma_pitch_deg": float(pitch),
        "sigma_lateral_m": float(lateral),
        "sigma_along_m": float(along),
        "condition": float(variances[-1] / max(variances[0], 1e-300)),
        "residual_px": float("nan"),
        "edge_points": fit.samples,
        "landmarks": 0,
        "one_sided": False,
        "accepted": not reason,
        "reason": reason,
    }


def _row(
    task: Task, fit: Fit, reason: str, by_centre: Floats, sigma_cy_px: float
) -> dict[str, Any]:
    start, pose = task.start, pose_of(task.start, fit.unknowns)
    # Neighbours share the errors of the edges, all images of a drive its principal point. What
    # these may be off is in the sigmas, and does not speak against any image.
    moved = moved_by_centre(fit, task, by_centre)
    stated = with_shared_edges(fit, task)
    whole = replace(stated, covariance=stated.covariance + np.outer(moved, moved))
    heading, own_pitch, lateral, along = sigmas(whole, task)
    pitch_by_cy = float(np.degrees(sigma_cy_px / pose.focal_px))
    by_focal, turns = moved_by_focal(stated), heading_turns(task)
    known = reached(task, fit)
    return {
        "x": pose.x_m,
        "y": pose.y_m,
        "z": pose.z_m,
        "heading_deg": pose.heading_deg,
        "pitch_deg": pose.pitch_deg,
        "roll_deg": pose.roll_deg,
        "focal_px": pose.focal_px,
        "cx_px": pose.cx_px,
        "cy_px": start.cy_px,
        "width_px": start.width_px,
        "height_px": start.height_px,
        "sigma_heading_deg": heading,
        "sigma_pitch_deg": float(np.hypot(own_pitch, pitch_by_cy)),
        "sigma_lateral_m": lateral,
        "sigma_along_m": along,
        "sigma_cx_px": float(moved[CX]),
        "heading_by_cx_deg": float(turns @ moved),
        "sigma_focal_ratio": float(by_focal[FOCAL]),
        "heading_by_focal_deg": float(turns @ by_focal),
        "pitch_by_cy_deg": pitch_by_cy,
        "condition": condition(fit, task),
        "residual_px": residual_px(fit, known=known),
        "edge_points": int(known.sum()),
        "landmarks": agreeing_landmarks(task, fit),
        "accepted": not reason,
        "reason": reason,
    }


# What the pole study's alignment reads: raw edge points, all edge pixels, lines of travel.

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


main = Command(align_cameras)


if __name__ == "__main__":
    sys.exit(main())
