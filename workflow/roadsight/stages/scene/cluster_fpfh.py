"""Smooth and rough ground by FPFH and k-means."""

from __future__ import annotations

import logging
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.base.sections.run import Run
from roadsight.base.sections.scene import GroundClasses
from roadsight.io.cloud.tiles import CloudTiles, in_bounds, stack_xyz
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.scene.pavement.fpfh import (
    SmoothnessModel,
    describe_ground,
    fit_smoothness,
    is_smooth,
)
from roadsight.scene.profile import plan_spacing_m, uses_intensity
from roadsight.stages.command import Command

log = logging.getLogger("cluster_fpfh")

_HALO_COLUMNS = 20
"""Columns around a tile that are read with it: they hold both rings of neighbours of an FPFH."""


def cluster_fpfh(
    cloud: Path,
    ground: Path,
    profile: Path,
    settings: GroundClasses,
    seed: Annotated[int, Run],
    *,
    out: Path,
) -> None:
    """Describe the ground tile by tile, fit two classes on a sample, then classify each tile."""
    spacing_m = plan_spacing_m(read_json(profile)["density_per_m2"]["median"])
    size_m = max(settings.voxel_size_m, spacing_m)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".fpfh") as folder:
        parts: list[tuple[pd.DataFrame, Path]] = []
        for columns, histograms in _described_tiles(cloud, ground, settings, size_m):
            parts.append((columns, Path(folder, f"{len(parts)}.npy")))
            np.save(parts[-1][1], histograms.astype(np.float16))
        columns = pd.concat([part for part, _ in parts], ignore_index=True)
        if len(columns) < 100:
            raise InputError(
                "too little ground for pavement",
                where=str(ground),
                found=f"{len(columns)} thinned ground points",
                allowed="at least 100",
            )
        use = uses_intensity(settings.intensity, spacing_m)
        if use and columns["intensity"].nunique() < 2:
            log.warning("the cloud has no intensity: pavement rests on FPFH alone")
            use = False
        model = _fit(columns, [file for _, file in parts], use, settings, seed)
        columns["smooth"] = np.concatenate(
            [_classify(model, part, np.load(file)) for part, file in parts]
        )
    if np.isfinite(model.tone_range).any():
        log.info("intensity forms no two groups: it takes only its outliers from smooth ground")
    about = {"voxel_size_m": size_m, "thinning": settings.thinning, "intensity_used": use}
    log.info("%.1f %% of %d columns are smooth", 100 * columns["smooth"].mean(), len(columns))
    write_table(out, columns, about)


def _described_tiles(
    cloud_path: Path, ground_path: Path, settings: GroundClasses, size_m: float
) -> Iterator[tuple[pd.DataFrame, np.ndarray]]:
    """Thinned ground of each tile (float32 columns x, y, z, intensity, variation) and its FPFH."""
    cloud = CloudTiles(cloud_path)
    mask = read_table(ground_path)["ground"].to_numpy()
    tiles = _ground_tiles(cloud, mask, _HALO_COLUMNS * size_m)
    for number, (core, xyz, intensity) in enumerate(tiles, start=1):
        ways = settings.neighbours, settings.fpfh_engine, settings.thinning
        ground = describe_ground(xyz, intensity, size_m, *ways)
        # A column belongs to the tile that holds its grid cell's centre.
        x, y = ((np.floor(ground.xyz_m[:, axis] / size_m) + 0.5) * size_m for axis in (0, 1))
        own = in_bounds(x, y, core)
        table = pd.DataFrame(ground.xyz_m[own], columns=["x", "y", "z"])
        table["intensity"] = ground.intensity[own]
        table["variation"] = ground.variation[own]
        log.info("tile %d of %d: %d columns", number, len(cloud.tiles), len(table))
        yield table.astype(np.float32), ground.histograms[own]


def _ground_tiles(
    cloud: CloudTiles, ground: np.ndarray, halo_m: float
) -> Iterator[tuple[tuple[float, float, float, float], np.ndarray, np.ndarray]]:
    """Core bounds, ground points and their intensity, with halo, of each tile."""
    starts = np.cumsum([0, *(tile.rows for tile in cloud.tiles)])
    kept: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for number, tile in enumerate(cloud.tiles):
        size = cloud.tile_size_m
        core = (tile.ix * size, tile.iy * size, (tile.ix + 1) * size, (tile.iy + 1) * size)
        near = [
            other
            for other, t in enumerate(cloud.tiles)
            if abs(t.ix - tile.ix) <= 1 and abs(t.iy - tile.iy) <= 1
        ]
        for other in near:
            if other not in kept:
                points = cloud.read(("x", "y", "z", "intensity"), [other])
                mask = ground[starts[other] : starts[other + 1]]
                xyz = stack_xyz(points)[mask].astype(np.float64)
                kept[other] = (xyz, points["intensity"][mask].astype(np.float64))
        kept = {other: kept[other] for other in kept if other in near or other > number}
        xyz = np.concatenate([kept[other][0] for other in near])
        intensity = np.concatenate([kept[other][1] for other in near])
        wide = (core[0] - halo_m, core[1] - halo_m, core[2] + halo_m, core[3] + halo_m)
        inside = in_bounds(xyz[:, 0], xyz[:, 1], wide)
        yield core, xyz[inside], intensity[inside]


def _fit(
    columns: pd.DataFrame,
    files: list[Path],
    use_intensity: bool,
    settings: GroundClasses,
    seed: int,
) -> SmoothnessModel:
    """Fit the classes on a sample of rows, the same whatever the tiles."""
    rng = np.random.default_rng(seed)
    count = min(settings.sample, len(columns))
    rows = np.sort(rng.choice(len(columns), count, replace=False))
    sizes = [len(np.load(file, mmap_mode="r")) for file in files]
    starts = np.cumsum([0, *sizes])
    histograms = np.concatenate(
        [
            np.load(file, mmap_mode="r")[rows[(rows >= start) & (rows < start + size)] - start]
            for file, start, size in zip(files, starts, sizes, strict=False)
        ]
    )
    sample = columns.iloc[rows].astype(np.float64)
    intensity = sample["intensity"].to_numpy() if use_intensity else None
    return fit_smoothness(
        histograms.astype(np.float32),
        sample["variation"].to_numpy(),
        intensity,
        settings.intensity_weight,
        seed,
        judge=settings.intensity == "auto",
    )


def _classify(model: SmoothnessModel, table: pd.DataFrame, histograms: np.ndarray) -> np.ndarray:
    columns = table.astype(np.float64)
    return is_smooth(
        model,
        histograms.astype(np.float32),
        columns["variation"].to_numpy(),
        columns["intensity"].to_numpy(),
    )


main = Command(cluster_fpfh)


if __name__ == "__main__":
    sys.exit(main())
