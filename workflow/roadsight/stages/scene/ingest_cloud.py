"""Read a site's clouds into the local frame: tiled points and the frame they are in.

The points are sorted into tiles while they are read for the first time, in the frame that the
headers promise. Where the points prove a header wrong, or are left out at its corner, or are
reprojected, the clouds are read again. Memory stays bounded by the largest tile.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Scene
from roadsight.geometry.crs import unit_name
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice, resolve
from roadsight.geometry.site import Reprojection, SiteFrame, centre_of, reprojection, site_frame
from roadsight.io.cloud.chunks import Chunk, in_share
from roadsight.io.cloud.cloud_scan import (
    OVERLAP,
    CloudScan,
    RepeatedSample,
    Take,
    check_copies,
    first_ones,
    kept_chunks,
    scan_cloud,
    steps_of,
)
from roadsight.io.cloud.clouds import CHUNK_POINTS, read_extent, read_header
from roadsight.io.cloud.tile_writer import (
    TileDraft,
    TileWriter,
    colour_shift,
    is_coloured,
    tile_columns,
)
from roadsight.io.cloud.tiles import Tile
from roadsight.io.records.atomic import write_json
from roadsight.io.vector.site_bounds import Within
from roadsight.io.vector.site_bounds import read_extent as read_site_extent
from roadsight.stages.command import Command

log = logging.getLogger(__name__)


def ingest(
    clouds: Sequence[Path],
    choice: UnitChoice,
    target_crs: str | None,
    tile_size_m: float,
    cloud_path: Path,
    frame_path: Path,
    chunk_points: int = CHUNK_POINTS,
    overlap: str = OVERLAP,
    extent: Callable[[Frame], Within] | None = None,
    pulse_share: float = Scene().pulse_share,
) -> None:
    """Read ``clouds``, check them and write the tiled cloud and its frame.

    Parameters
    ----------
    clouds : LAS or LAZ files of one site.
    choice : configured CRS and units.
    target_crs : CRS to reproject to on the way in, or None.
    tile_size_m : edge of a tile, whole metres, so that tiles are made of whole cells.
    chunk_points : points looked at together; the result does not depend on it.
    overlap : whether points of overlapping flight lines take part, see `kept_chunks`.
    extent : gives, in the site's frame, which places belong to the site; None: all.
    pulse_share : of the pulses that take part, see `in_share`.

    Raises
    ------
    InputError : a cloud cannot be read, CRS and units are missing, contradictory or impossible, or
        the extent holds no point.
    """
    _check_arguments(clouds, tile_size_m)
    moved = target_crs or extent is not None or pulse_share < 1.0
    promised, coloured = (None, False) if moved else _promised(clouds, choice)
    with TileDraft(cloud_path, tile_size_m, promised, coloured) as draft:
        sample = RepeatedSample(steps_of(clouds))

        def take(path: str | os.PathLike[str], chunk: Chunk) -> None:
            sample.take(path, chunk)
            draft.take(path, chunk)

        site, scans, move = survey(clouds, choice, target_crs, chunk_points, take, overlap)
        for note in notes_of(site, scans):
            log.warning("%s", note)
        first: list[Bools | None] = [None] * len(clouds)
        if sample.share:
            first = list(first_ones(clouds, cloud_path.parent, overlap))
        repeated = sum(int(np.count_nonzero(~ones)) for ones in first if ones is not None)
        if repeated:
            told = "clouds overlap, or hold copies: %d points are there twice and count once"
            log.warning(told, repeated)
        tiles = None if repeated else draft.finish(site.frame, scans)
    outside = thinned = 0
    steps = steps_of(clouds)
    within = None if extent is None else extent(site.frame)
    if tiles is None:
        log.info("reading again: the points differ from what the headers say, or are not all kept")
        with TileWriter(cloud_path, tile_size_m, is_coloured(scans)) as writer:
            for scan, ones in zip(scans, first, strict=True):
                shift, done = colour_shift(scan.brightest), 0
                times = pulse_share < 1.0
                for chunk, *_ in kept_chunks(scan.header.path, move, chunk_points, overlap, times):
                    part = None if ones is None else ones[done : done + len(chunk)]
                    done += len(chunk)
                    kept = chunk if part is None else chunk.select(part)
                    if within is not None:
                        inside = within(site.frame.to_local(kept.xyz[:, :2]))
                        outside += int(np.count_nonzero(~inside))
                        kept = kept.select(inside)
                    if pulse_share < 1.0:
                        chosen = in_share(kept.xyz, steps, kept.time, pulse_share)
                        thinned += int(np.count_nonzero(~chosen))
                        kept = kept.select(chosen)
                    writer.append(tile_columns(kept, site.frame, shift))
            _check_extent(outside, scans, repeated)
            _check_share(
                pulse_share, thinned, sum(scan.points for scan in scans) - repeated - outside
            )
            tiles = writer.finish()
    if outside:
        log.info("the extent leaves %d points out", outside)
    if thinned:
        log.warning("scene.pulse_share: %d points of left out pulses take no part", thinned)
    dropped = {"repeated": repeated, "outside": outside, "thinned": thinned}
    write_json(frame_path, describe(site, scans, tiles, tile_size_m, dropped))
    log.info("%d points in %d tiles", sum(tile.rows for tile in tiles), len(tiles))


def survey(
    clouds: Sequence[Path],
    choice: UnitChoice,
    target_crs: str | None = None,
    chunk_points: int = CHUNK_POINTS,
    take: Take | None = None,
    overlap: str = OVERLAP,
) -> tuple[SiteFrame, list[CloudScan], Reprojection | None]:
    """First pass: what the clouds hold, the frame they share and the way into its CRS.

    Parameters
    ----------
    take : called with each cloud's path and its points as they come, before reprojection.

    Raises
    ------
    InputError : as `ingest`.
    """
    scans = [scan_cloud(cloud, None, chunk_points, take, overlap) for cloud in clouds]
    stated = [(str(scan.header.path), scan.header.stated) for scan in scans]
    centre, units_stated = centre_of(*_corners(scans)), choice.units != "auto"
    reference, move = resolve(stated, centre, choice), None
    if target_crs:
        reference, move = reprojection(reference, target_crs, centre, units_stated)
        scans = [scan_cloud(cloud, move, chunk_points, None, overlap) for cloud in clouds]
        units_stated = True
    where = ", ".join(str(cloud) for cloud in clouds)
    return site_frame(reference, *_corners(scans), where, units_stated), scans, move


def notes_of(site: SiteFrame, scans: Sequence[CloudScan]) -> list[str]:
    """Assumptions and contradictions of a site and of the headers of its clouds."""
    headers = [scan.header for scan in scans]
    of_headers = [f"{header.path.name}: {note}" for header in headers for note in header.notes]
    return [*site.reference.notes, *of_headers]


def describe(
    site: SiteFrame,
    scans: Sequence[CloudScan],
    tiles: Sequence[Tile],
    tile_size_m: float,
    dropped: Mapping[str, int],
) -> dict[str, Any]:
    """Content of ``scene/frame.json``; ``dropped`` counts points left out beside the filter's."""
    corners = np.array([tile.bounds_m for tile in tiles])
    bounds_m = [*corners[:, :3].min(axis=0).tolist(), *corners[:, 3:].max(axis=0).tolist()]
    return site.frame.to_dict() | {
        "points": sum(tile.rows for tile in tiles),
        "bounds_m": bounds_m,
        "tile_size_m": tile_size_m,
        "crs_name": site.reference.name,
        "crs_source": site.reference.source,
        "unit": unit_name(site.frame.unit_m),
        "vertical_unit": unit_name(site.frame.vertical_unit_m),
        "location": None if site.location is None else asdict(site.location),
        "notes": notes_of(site, scans),
        "inputs": {str(scan.header.path): scan.sha256 for scan in scans},
        "input_boxes_m": [
            site.frame.to_local(np.stack([scan.lower[:2], scan.upper[:2]])).ravel().tolist()
            for scan in scans
        ],
        "dropped": {
            "withheld": sum(scan.withheld for scan in scans),
            "noise": sum(scan.noise for scan in scans),
            "synthetic": sum(scan.synthetic for scan in scans),
            "overlap": sum(scan.overlap for scan in scans),
            **dropped,
        },
    }


def _check_extent(outside: int, scans: Sequence[CloudScan], repeated: int) -> None:
    """Refuse an extent that misses the clouds, before they become a site without points."""
    if outside and outside == sum(scan.points for scan in scans) - repeated:
        (west, south, _), (east, north, _) = _corners(scans)
        raise InputError(
            "holds no point of the clouds",
            where="extent",
            allowed=f"part of x {west:.10g} to {east:.10g}, y {south:.10g} to {north:.10g}",
            hint="give it in the clouds' coordinates, or a file that names its CRS",
        )


def _check_share(pulse_share: float, thinned: int, points: int) -> None:
    """Refuse a share of the pulses that leaves nothing."""
    if thinned and thinned == points:
        raise InputError(
            "leaves no point",
            where="scene.pulse_share",
            found=pulse_share,
            allowed=f"more than {1 / points:.2g} of {points} points",
        )


def _check_arguments(clouds: Sequence[Path], tile_size_m: float) -> None:
    if repeated := sorted({str(cloud) for cloud in clouds if clouds.count(cloud) > 1}):
        raise InputError("the same cloud is listed twice", where=repeated[0])
    check_copies(clouds)
    if not (tile_size_m >= 1 and float(tile_size_m).is_integer()):
        raise InputError(
            "tiles must be made of whole metres",
            where="tile_size_m",
            found=tile_size_m,
            allowed="1, 2, ... m",
        )


def _corners(scans: Sequence[CloudScan]) -> tuple[Floats, Floats]:
    """Least and greatest native x, y, z of all clouds."""
    lower = np.stack([scan.lower for scan in scans]).min(axis=0)
    return lower, np.stack([scan.upper for scan in scans]).max(axis=0)


def _promised(clouds: Sequence[Path], choice: UnitChoice) -> tuple[Frame | None, bool]:
    """Frame and colour that the headers promise; no frame where they cannot be right."""
    try:
        headers = [read_header(cloud) for cloud in clouds]
        corners = np.array([read_extent(cloud) for cloud in clouds])
        lower, upper = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        stated = [(str(header.path), header.stated) for header in headers]
        reference = resolve(stated, centre_of(lower, upper), choice)
        frame = site_frame(reference, lower, upper, "headers", choice.units != "auto").frame
    except InputError:
        return None, False
    return frame, all(header.coloured for header in headers)


def ingest_cloud(
    clouds: Sequence[Path],
    site: str,
    choice: UnitChoice,
    settings: Scene,
    target_crs: Annotated[str | None, "reproject to this projected CRS"] = None,
    extent: Annotated[str | None, "KIND=VALUE, see `read_extent`"] = None,
    extent_files: Sequence[Path] = (),
    extent_crs: Annotated[str | None, "of extent files that name none"] = None,
    *,
    cloud: Annotated[Path, "tiled cloud to write"],
    frame: Annotated[Path, "frame to write"],
) -> None:
    """Read the clouds of a site; what is wrong with them is told with its name."""
    kind, _, value = (extent or "").partition("=")

    def within(found: Frame) -> Within:
        return read_site_extent(kind, value, found, extent_files, extent_crs)

    try:
        ingest(
            clouds,
            choice,
            target_crs,
            settings.tile_size_m,
            cloud,
            frame,
            overlap=settings.overlap,
            extent=within if extent else None,
            pulse_share=settings.pulse_share,
        )
    except InputError as error:
        raise InputError(str(error), where=f"site {site}") from error


main = Command(ingest_cloud)


if __name__ == "__main__":
    sys.exit(main())
