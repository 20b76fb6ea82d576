"""Yaw of side views that the drive's calibration did not find, from what images share."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.geometry.cameras import Intrinsics, cam_from_world
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.poles.alignment.pose import FOCAL
from roadsight.poles.calibration.calibration_table import from_content
from roadsight.poles.drive.drive_lenses import lens_of, with_given
from roadsight.poles.images.image_matches import (
    Features,
    Votes,
    agreed_turn,
    features,
    matched,
    turn_votes,
)
from roadsight.poles.images.views import VIEWS, side_intrinsics
from roadsight.stages.command import Command, logged

log = logging.getLogger("turn_side_views")
_Row = Mapping[Hashable, Any]
_Seen = tuple[Features, tuple[int, int]]
"""Points of an image, and its width and height."""
_PLACES = 40
"""Places of a drive that are looked at, evenly along it; eighteen were enough on the generated
rural road."""
_NEAREST_M, _FARTHEST_M = 3.0, 30.0
"""Way between the two places of a pair: shorter, nothing new enters the side view; longer, it shows
other things."""


def turn_side_views(
    frames_path: Path,
    calibration: Path,
    images_path: str,
    cameras_paths: Annotated[Sequence[Path], "cameras of all shards"],
    drive_path: Annotated[Path | None, "profile whose lenses distort; none: pinholes"] = None,
    lenses_json: Annotated[str, "given lenses as JSON: route, k1, k2, focal_px"] = "[]",
    *,
    out: Path,
) -> None:
    """Write the yaw of each side view that the calibration leaves open, by drive and view."""
    frames = read_table(frames_path)
    cameras = pd.concat([read_table(path) for path in cameras_paths], ignore_index=True)
    posed = frames.merge(cameras[cameras["accepted"]], on="image", suffixes=("_frame", ""))
    images = ImageSource(images_path)
    lenses = None
    if drive_path:
        lenses = with_given(read_json(drive_path)["lenses"], json.loads(lenses_json))

    @lru_cache(maxsize=8)
    def found(path: str) -> _Seen:
        image = images.read(path)
        return features(image), (image.shape[1], image.shape[0])

    turns = []
    for drive in map(from_content, read_json(calibration)["drives"]):
        route, width, height = drive.key
        own = posed[
            (posed["route"].astype(str) == route)
            & (posed["width_px"] == width)
            & (posed["height_px"] == height)
        ].sort_values("sequence", kind="stable")
        for number, view in enumerate(VIEWS[1:], start=1):
            pairs = list(_pairs(own, f"{view}_path"))
            if np.isfinite(drive.turns.sigma_deg[number]) or not pairs:
                continue
            chosen = pairs[:: -(-len(pairs) // _PLACES)]
            votes = []
            for one, other in logged(chosen, len(chosen), log, f"pairs, {route} {view}"):
                votes.append(_votes(one, other, f"{view}_path", found, lenses))
            deg, sigma = agreed_turn(
                Votes(
                    np.concatenate([part.turn_deg for part in votes]),
                    np.concatenate([part.weight for part in votes]),
                )
            )
            # Votes agree whatever the lens; a longer one with views turned less looks the same.
            lens_sigma = float(np.sqrt(drive.mount.covariance[FOCAL, FOCAL]))
            sigma = float(np.hypot(sigma, deg * lens_sigma))
            log.info("%s %s view: %.2f +- %.2f degrees", route, view, deg, sigma)
            if np.isfinite(deg):
                key = {"route": route, "width_px": width, "height_px": height}
                turns.append(key | {"view": view, "turn_deg": deg, "sigma_deg": sigma})
    write_json(out, {"turns": turns})


def _pairs(drive: pd.DataFrame, path: str) -> Iterator[tuple[_Row, _Row]]:
    """Places of a drive that follow each other, the later with an image of the side view."""
    rows = drive.to_dict("records")
    for one, other in pairwise(rows):
        gap_m = float(np.hypot(other["x"] - one["x"], other["y"] - one["y"]))
        if _NEAREST_M <= gap_m <= _FARTHEST_M and isinstance(other.get(path), str) and other[path]:
            yield one, other


def _votes(
    one: _Row,
    other: _Row,
    path: str,
    found: Callable[[str], _Seen],
    lenses: list[dict[str, Any]] | None,
) -> Votes:
    """Votes of what an earlier front view and a later side view share."""
    (first, _), (second, size_px) = found(one["path"]), found(other[path])
    numbers = matched(first, second)
    here, there = first.uv_px[numbers[:, 0]], second.uv_px[numbers[:, 1]]
    front = _intrinsics(one)
    side = side_intrinsics(_intrinsics(other), *size_px)
    if lenses is not None:
        size = front.width_px, front.height_px
        key = str(one["route"]), *size
        here = lens_of(lenses, key, size[::-1]).undistort(here)
        there = lens_of(lenses, key, size_px[::-1]).undistort(there)
        known = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
        here, there = here[known], there[known]
    way_m = np.array([other[name] - one[name] for name in "xyz"])
    return turn_votes(_rays(front, here) @ _turned(one), way_m, _rays(side, there), _turned(other))


def _intrinsics(row: _Row) -> Intrinsics:
    names = ("focal_px", "cx_px", "cy_px")
    return Intrinsics(int(row["width_px"]), int(row["height_px"]), *(float(row[n]) for n in names))


def _turned(row: _Row) -> Floats:
    return cam_from_world(*(float(row[f"{name}_deg"]) for name in ("heading", "pitch", "roll")))


def _rays(camera: Intrinsics, uv_px: Floats) -> Floats:
    middle = np.array([camera.cx_px, camera.cy_px])
    return np.column_stack([(uv_px - middle) / camera.focal_px, np.ones(len(uv_px))])


main = Command(turn_side_views)


if __name__ == "__main__":
    sys.exit(main())
