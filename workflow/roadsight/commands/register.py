"""``roadsight register``: the baseline of a vehicle's camera from clicked pairs."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.api.drive import DriveFiles
from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.io.records.text_tables import read_text_table
from roadsight.poles.alignment.drive import places_of
from roadsight.poles.alignment.pose import Start
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.poles.calibration.registration import (
    FEWEST_PAIRS,
    Registration,
    baseline,
    is_flat,
    register_camera,
)


def run(
    pairs_path: Annotated[str, "CSV: image, pixel_x, pixel_y; x, y or lon, lat; z if known"],
    /,
    videolog: Annotated[str, "CSV: image, latitude, longitude, ..."],
    drive: DriveFiles,
    *,
    out: Annotated[Path, "JSON to write, for poles.baseline"],
) -> None:
    """Write one baseline for each image size.

    Raises
    ------
    InputError : the pairs cannot be read, or those of an image do not determine its camera.
    """
    if out.suffix.lower() != ".json":
        raise InputError("is no name for it", where=f"--out {out}", allowed=".json")
    _check_counts(pairs_path)
    from roadsight.api.alignment import Chain  # noqa: PLC0415  # slow to load
    from roadsight.stages.command import told_clearly  # noqa: PLC0415  # of the same

    with told_clearly("register"), tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        chain = Chain(Path(folder), videolog, drive)
        chain.scene()
        chain.track()
        chain.road()
        frame = Frame.from_dict(read_json(chain.frame))
        pairs = _on_ground(read_pairs(pairs_path, frame), chain.dem, frame)
        frames = read_table(chain.frames)
        frames = frames[(frames["status"] == "ok") & np.isfinite(frames["z_road"])]
        edges = RoadEdges.from_points(
            read_table(chain.road_edges, ["x", "y", "z"]).to_numpy(np.float64)
        )
        found_places = places_of(frames.reset_index(drop=True), edges)
        places = {place.image: place for place in found_places}
    found: dict[str, list[tuple[Registration, Start]]] = {}
    for image, own in ((str(name), own) for name, own in pairs.groupby("image", sort=True)):
        if image not in places:
            raise InputError(
                "an image of the pairs is not in the videolog, or not usable there",
                where=pairs_path,
                found=image,
                allowed=f"{len(places)} images",
            )
        start = places[image].start
        size = start.width_px, start.height_px
        try:
            registration = register_camera(own[["u", "v"]], own[["x", "y", "z"]], *size)
        except InputError as error:
            raise InputError(str(error), where=f"{pairs_path}: {image}") from error
        found.setdefault(f"{size[0]}x{size[1]}", []).append((registration, start))
        flat = "; all places on one plane: the focal length rests on little"
        print(f"{image}: {len(own)} pairs{flat if is_flat(own[['x', 'y', 'z']]) else ''}")
        for (_, row), gap in zip(own.iterrows(), registration.residuals_px, strict=True):
            print(f"  pixel {row['u']:.1f}, {row['v']:.1f}: off by {gap:.2f} px")
    content = {name: baseline(images) for name, images in found.items()}
    write_json(out, content)
    for name, one in content.items():
        print(
            f"{name}: focal length {one['focal_px']:.1f} px, height {one['height_m']:.2f} m, "
            f"yaw {one['yaw_deg']:.2f}, pitch {one['pitch_deg']:.2f}, roll {one['roll_deg']:.2f} "
            f"degrees; {one['pairs']} pairs within {one['rms_px']:.2f} px: {out}"
        )


def _check_counts(path: str) -> None:
    """Too few pairs are told before the cloud is read."""
    table = read_text_table(path)
    if "image" not in table:
        raise InputError("lacks the column image", where=path, found=", ".join(table.columns))
    counts = table["image"].str.strip().value_counts()
    if counts.min() < FEWEST_PAIRS:
        image = str(counts.sort_index().idxmin())
        raise InputError(
            "too few clicked pairs",
            where=f"{path}: {image}",
            found=int(counts[image]),
            allowed=f">= {FEWEST_PAIRS} in each image",
        )


def _on_ground(pairs: pd.DataFrame, dem: Path, frame: Frame) -> pd.DataFrame:
    """Pairs whose missing heights are those of the terrain."""
    open_ = pairs["z"].isna().to_numpy()
    if not open_.any():
        return pairs
    height = read_raster(dem, frame).sample(pairs["x"].to_numpy(), pairs["y"].to_numpy())
    if not np.isfinite(height[open_]).all():
        row = int(np.flatnonzero(open_ & ~np.isfinite(height))[0])
        raise InputError(
            "a place without z lies outside the terrain",
            where=f"pairs, line {row + 2}",
            hint="give its z, or check its coordinates",
        )
    return pairs.assign(z=np.where(open_, height, pairs["z"]))


# Names of the columns of a place: in the site's CRS, or in degrees.
_PLACES = (("x", "y"), ("lon", "lat"), ("longitude", "latitude"))


def read_pairs(path: str | os.PathLike[str], frame: Frame) -> pd.DataFrame:
    """Pairs: image, u and v (pixels), x, y, z in local metres; z is NaN where it is left empty.

    Parameters
    ----------
    path : CSV with image, pixel_x, pixel_y; x, y in the cloud's CRS or lon, lat; and z in the
        cloud's vertical unit, where it is known.

    Raises
    ------
    InputError : the file cannot be read, lacks a column, or a number is missing or impossible.
    """
    table = read_text_table(path)
    place = next((pair for pair in _PLACES if set(pair) <= set(table.columns)), None)
    missing = [name for name in ("image", "pixel_x", "pixel_y") if name not in table]
    if missing or place is None:
        raise InputError(
            f"lacks the column {', '.join(missing) or 'x, y or lon, lat'}",
            where=str(path),
            found=", ".join(table.columns),
            allowed="image, pixel_x, pixel_y; x, y or lon, lat; z if known",
        )
    numbers = table[["pixel_x", "pixel_y", *place]].apply(pd.to_numeric, errors="coerce")
    given = numbers.to_numpy(np.float64)
    height = np.full(len(table), np.nan)  # as given, NaN where left empty
    if "z" in table:
        text = table["z"].str.strip()
        height = pd.to_numeric(text.where(text != ""), errors="coerce").to_numpy(np.float64)
        wrong = (text != "").to_numpy() & ~np.isfinite(height)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                "z is no number", where=f"{path}, line {row + 2}", found=text.iloc[row]
            )
    if place[0] == "x":
        xyz = frame.to_local(np.column_stack([given[:, 2:], height]))
    elif frame.crs_wkt is None:
        raise InputError("lon, lat need a cloud with a CRS", where=str(path), hint="give x, y")
    else:
        xy = SiteNorth(frame).to_local(given[:, 3], given[:, 2])
        z = frame.to_local(np.column_stack([np.zeros((len(table), 2)), height]))[:, 2]
        xyz = np.column_stack([xy, z])
    wrong = ~np.isfinite(np.column_stack([given[:, :2], xyz[:, :2]])).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "a number is missing or not finite",
            where=f"{path}, line {row + 2}",
            found=table.iloc[row].tolist(),
        )
    columns = {"u": given[:, 0], "v": given[:, 1], "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2]}
    return pd.DataFrame({"image": table["image"].str.strip(), **columns})


VERB = Verb("register", "solve a camera's baseline from clicked pairs", run)
