"""Measure what a drive is like: what decides which effects of the pole job matter."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from roadsight.geometry.frames import Frame
from roadsight.geometry.lens import RadialLens
from roadsight.io.atomic import read_json, write_json
from roadsight.io.camera_tables import read_cameras
from roadsight.io.rasters import read_raster
from roadsight.io.tables import read_table
from roadsight.io.videologs import ImageSource
from roadsight.poles.drive_profile import (
    Key,
    frames_of,
    front_view_gap,
    given_lens,
    has_sides,
    hidden_share,
    keys_of,
    lens_content,
    measured_lens,
)
from roadsight.stages.command import run_stage

log = logging.getLogger("profile_drive")
_UNTOLD = "not measured"


def profile_drive(arguments: argparse.Namespace) -> None:
    """Write the profile of a site's drives."""
    frame = Frame.from_dict(read_json(arguments.frame))
    frames = read_table(arguments.frames)
    usable = frames[(frames["status"] == "ok") & np.isfinite(frames["z_road"])]
    edges = read_table(arguments.road_edges, ["x", "y", "z"]).to_numpy(np.float64)
    height = read_raster(arguments.dem, frame).sample
    hfov_deg = _hfov_deg(arguments, keys_of(usable))
    known = None
    if hfov_deg:
        reach = arguments.max_distance_m, arguments.min_views
        known = front_view_gap(usable, hfov_deg, *reach)
    content = {
        "images": len(usable),
        "hidden_road_share": hidden_share(usable, edges, height, arguments.farthest_m),
        "side_share": float(has_sides(usable).mean()) if len(usable) else 0.0,
        "hfov_deg": hfov_deg,
        "front_view_gap": known,
        "lenses": [_lens(key, usable, arguments) for key in keys_of(usable)],
        "posed_share": _posed_share(usable, arguments.cameras, frame, arguments.intrinsics),
        "farthest_m": arguments.farthest_m,
        "max_distance_m": arguments.max_distance_m,
    }
    log.info("%s", json.dumps(content))
    write_json(arguments.out, content)


def _hfov_deg(arguments: argparse.Namespace, keys: list[Key]) -> float | None:
    """Narrowest field of view that settings or baselines state for the drives; None if unknown."""
    if arguments.hfov_deg:
        return float(arguments.hfov_deg)
    baselines = read_json(arguments.baseline) if arguments.baseline else {}
    widths = []
    for _, width, tall in keys:
        stated = baselines.get(f"{width}x{tall}", baselines.get("all", {}))
        if "focal_px" in stated:
            widths.append(float(np.degrees(2 * np.arctan(0.5 * width / stated["focal_px"]))))
        elif "hfov_deg" in stated:
            widths.append(float(stated["hfov_deg"]))
        else:
            return None
    return min(widths, default=None)


def _lens(key: Key, frames: pd.DataFrame, arguments: argparse.Namespace) -> dict[str, Any]:
    """Lens of a drive: given, measured in its images, or none where nobody asks."""
    given = given_lens(key, json.loads(arguments.lenses))
    if given is not None:
        return given
    if arguments.measure_lens == "no":
        return lens_content(key, RadialLens.centred(0.0, 0.0, *key[1:]), 0.0, None, _UNTOLD)
    source = ImageSource(arguments.images)
    return measured_lens(key, frames_of(frames, key)["path"], source.read)


def _posed_share(
    frames: pd.DataFrame, cameras: str | None, frame: Frame, intrinsics: str | None
) -> float:
    """Share of the images whose camera the site gives."""
    if not cameras or frames.empty:
        return 0.0
    given = read_cameras(cameras, frame, intrinsics)
    return float(frames["image"].isin(given["image"]).mean())


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("frames", "road-edges", "dem", "frame", "images", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--baseline", nargs="?", help="registered cameras, for the field of view")
    parser.add_argument("--cameras", nargs="?", help="given cameras, CSV")
    parser.add_argument("--intrinsics", nargs="?", help="their lens, CSV, if not with them")
    parser.add_argument(
        "--lenses", default="[]", help="given lenses as JSON: route, k1, k2, focal_px"
    )
    parser.add_argument("--measure-lens", choices=("yes", "no"), default="yes")
    parser.add_argument("--hfov-deg", type=float, default=0.0, help="0: unknown")
    parser.add_argument("--farthest-m", type=float, default=240.0, help="of road edges")
    parser.add_argument("--max-distance-m", type=float, default=40.0, help="of sightings")
    parser.add_argument("--min-views", type=int, default=3, help="that a pole needs")
    return run_stage(parser, profile_drive, argv)


if __name__ == "__main__":
    sys.exit(main())
