"""Trees, guardrails and buildings of the cloud, for images to confirm."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.sections.poles import BlockClasses, SightingRules
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import Bounds, CloudTiles, in_bounds
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.buildings import (
    ROOF_AREA_M2,
    Block,
    BlockCells,
    block_cells,
    join_blocks,
    roof_cells,
    steady_roofs,
)
from roadsight.poles.sightings.buildings import SIGMA_M as BLOCK_SIGMA_M
from roadsight.poles.sightings.rails import RailReturns, find_rail_returns, join_rails
from roadsight.poles.sightings.trees import REACH_M as TRUNK_REACH_M
from roadsight.poles.sightings.trees import (
    SIGMA_M,
    Crowns,
    Trunks,
    canopy_cell_m,
    find_crowns,
    find_trunks,
    measure_density,
    reach_m,
)
from roadsight.poles.triangulate.cloud_objects import TRUNK_COLUMNS
from roadsight.stages.command import Command, logged

log = logging.getLogger("find_roadside_objects")
COLUMNS = ("kind", "object", "x", "y", "z_ground", "top_m", "width_m", "sigma_m", *TRUNK_COLUMNS)
BLOCKS = tuple(name for name, kind in KINDS.items() if kind.shape == "block")
_HALO_M = 6.0
"""Margin of a tile: more than what decides about a return of a rail. Crowns have their own."""


def find_roadside_objects(
    cloud_path: Path,
    frame: Path,
    dem: Path,
    kinds: Annotated[Sequence[str], SightingRules],
    classes: BlockClasses,
    *,
    out: Path,
) -> None:
    """Write a row for each tree, and one for each metre of each guardrail and of each outline."""
    ground = read_raster(dem, Frame.from_dict(read_json(frame)))
    cloud = CloudTiles(cloud_path)
    cell_m, halo_m = np.nan, _HALO_M
    if "tree" in kinds:
        # One for the whole cloud, by a first pass over its tiles.
        passed = (cloud.read(["x", "y"], [number]) for number in range(len(cloud.tiles)))
        cell_m = canopy_cell_m([measure_density(np.column_stack([p["x"], p["y"]])) for p in passed])
        # Of a trunk between two crowns either tile must see both.
        halo_m = max(_HALO_M, reach_m(cell_m) + 2 * TRUNK_REACH_M)
    tiles = cloud.iter_tiles(halo_m, ["x", "y", "z", "classification"])
    cells: dict[str, list[BlockCells]] = {kind: [] for kind in BLOCKS if kind in kinds}
    roofs: list[BlockCells] = []
    crowns, rails = [], [RailReturns(np.empty((0, 3)), np.empty((0, 2)))]
    for bounds, points in logged(tiles, len(cloud.tiles), log, "tiles"):
        xyz = np.column_stack([points[name] for name in "xyz"]).astype(np.float64)
        above = xyz[:, 2] - ground.sample(xyz[:, 0], xyz[:, 1])
        cls, here = points["classification"], in_bounds(xyz[:, 0], xyz[:, 1], bounds)
        if "tree" in kinds:
            found = find_crowns(xyz, above, cls, cell_m)
            trunks = find_trunks(found, xyz, above, cls, cell_m)
            crowns.append(_trees(found, trunks, bounds))
        if "guardrail" in kinds:
            returns = find_rail_returns(xyz, above, cls)
            own = in_bounds(returns.xyz_m[:, 0], returns.xyz_m[:, 1], bounds)
            rails.append(RailReturns(returns.xyz_m[own], returns.direction[own]))
        for kind, parts_of_kind in cells.items():
            block = np.isin(cls, getattr(classes, f"{kind}_classes")) & here
            parts_of_kind.append(block_cells(xyz[block]))
        if "building" in kinds and not _any_cells(cells["building"]):
            roofs.append(roof_cells(xyz, above, cls, here))
    lines = join_rails(
        RailReturns(
            np.concatenate([part.xyz_m for part in rails]),
            np.concatenate([part.direction for part in rails]),
        )
    )
    empty = pd.DataFrame({name: pd.Series(dtype=np.float64) for name in COLUMNS[2:-1]})
    trees = pd.concat(crowns, ignore_index=True) if crowns else empty
    trees = trees.sort_values(["x", "y"], kind="stable", ignore_index=True)
    trees["z_ground"] = ground.sample(trees["x"].to_numpy(), trees["y"].to_numpy())
    parts = [trees.assign(kind="tree", object=np.arange(len(trees)))]
    parts += [
        pd.DataFrame(line, columns=["x", "y", "z_ground"]).assign(kind="guardrail", object=number)
        for number, line in enumerate(lines)
    ]
    for kind, found_cells in cells.items():
        told = _any_cells(found_cells)
        if kind == "building" and not told:
            blocks = join_blocks(steady_roofs(roofs), replace(KINDS[kind], area_m2=ROOF_AREA_M2))
        else:
            blocks = join_blocks(found_cells, KINDS[kind])
        source = f"classes {getattr(classes, f'{kind}_classes')}"
        if not told:
            source += ", which no return has" + ", but by roofs" * (kind == "building")
        (log.info if told else log.warning)("%d of kind %s by %s", len(blocks), kind, source)
        parts += [_block(block, kind, number, ground) for number, block in enumerate(blocks)]
    table = pd.concat(parts, ignore_index=True).reindex(columns=list(COLUMNS))
    table["cloud_shows"] = table["cloud_shows"].astype(object).fillna("")
    table = table.astype({"object": np.int64, "kind": str, "cloud_shows": str})
    shown = table.loc[table["kind"] == "tree", "cloud_shows"].value_counts().to_dict()
    log.info("%d trees, of which the cloud shows %s; %d guardrails", len(trees), shown, len(lines))
    write_table(out, table, {"kinds": list(kinds)})


def _any_cells(parts: Sequence[BlockCells]) -> bool:
    return any(len(part.index) for part in parts)


def _trees(found: Crowns, trunks: Trunks, bounds: Bounds) -> pd.DataFrame:
    own = in_bounds(found.xy_m[:, 0], found.xy_m[:, 1], bounds)
    x, y = found.xy_m[own].T
    size = {"top_m": found.top_m[own], "width_m": found.width_m[own], "sigma_m": SIGMA_M}
    below = (*trunks.xy_m[own].T, trunks.sigma_m[own], trunks.shows[own])
    return pd.DataFrame({"x": x, "y": y, **size, **dict(zip(TRUNK_COLUMNS, below, strict=True))})


def _block(block: Block, kind: str, number: int, ground: Raster) -> pd.DataFrame:
    x, y = block.outline_m.T
    z = ground.sample(x, y)
    lowest = np.nanmin(z) if np.isfinite(z).any() else np.nan
    size = {"z_ground": z, "top_m": block.top_m - lowest, "width_m": np.sqrt(block.area_m2)}
    return pd.DataFrame(
        {"kind": kind, "object": number, "x": x, "y": y, **size, "sigma_m": BLOCK_SIGMA_M}
    )


main = Command(find_roadside_objects)


if __name__ == "__main__":
    sys.exit(main())
