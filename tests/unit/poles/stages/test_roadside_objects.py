import numpy as np
import pytest
from pyproj import CRS

from roadsight.base.sections.poles import BlockClasses
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table
from roadsight.poles.sightings.rails import find_rail_returns, join_rails
from roadsight.poles.sightings.trees import canopy_cell_m, find_crowns, find_trunks, measure_density
from roadsight.stages.poles.find_roadside_objects import find_roadside_objects

SIZE_M = 150.0
TILE_M = 25.0
SEAM_M = 75.0


def crown(rng, x, y, top_m, per_m2):
    """Returns in a crown 6 m wide."""
    count = int(9 * np.pi * per_m2)
    turn, out = rng.uniform(0, 2 * np.pi, count), 3.0 * np.sqrt(rng.uniform(0, 1, count))
    z = top_m * (0.6 + 0.4 * np.sqrt(1 - (out / 3.0) ** 2))
    z -= rng.exponential(0.1 * top_m, count).clip(max=0.4 * top_m)
    return np.column_stack([x + out * np.cos(turn), y + out * np.sin(turn), z])


def trunk(rng, x, y):
    """Six returns on a trunk half a metre beside the crown's middle."""
    at = np.column_stack([np.full(6, x + 0.5), np.full(6, y)]) + rng.normal(0, 0.05, (6, 2))
    return np.column_stack([at, np.linspace(0.8, 2.2, 6)])


def surveyed(rng, west, east):
    """Trees (n, 2) along the seam, and returns, fewer per square metre west of it than east."""
    y = np.arange(6.0, SIZE_M - 6.0, 9.0)
    trees = np.column_stack([SEAM_M + rng.uniform(-3, 3, len(y)), y])
    heights = rng.uniform(6, 13, len(y))
    halves = []
    for per_m2, low, high in ((west, 0.0, SEAM_M), (east, SEAM_M, SIZE_M)):
        ground = rng.uniform([low, 0], [high, SIZE_M], (int((high - low) * SIZE_M * per_m2), 2))
        parts = [np.column_stack([ground, np.zeros(len(ground))])]
        parts += [crown(rng, *p, top, per_m2) for p, top in zip(trees, heights, strict=True)]
        parts += [trunk(rng, *p) for p in trees]
        half = np.concatenate(parts)
        halves.append(half[(half[:, 0] >= low) & (half[:, 0] < high)])
    x = rng.uniform(10, 140, 400)
    rail = np.column_stack([x, 20.0 + 0.1 * x + rng.normal(0, 0.03, 400), np.full(400, 0.6)])
    return trees, np.concatenate([*halves, rail])


def objects(folder, xyz, cls):
    frame = Frame((500_000.0, 4_600_000.0, 0.0), 1.0, 1.0, CRS.from_epsg(32617).to_wkt())
    write_json(folder / "frame.json", frame.to_dict())
    write_raster(folder / "dem.tif", np.zeros((170, 170)), frame, -10.0, 160.0, 1.0)
    names = ("intensity", "return_number", "number_of_returns")
    points = dict(zip("xyz", xyz.T, strict=True)) | dict.fromkeys(names, np.ones(len(xyz)))
    with TileWriter(folder / "cloud.parquet", TILE_M, coloured=False) as writer:
        writer.append(points | {"classification": cls})
        writer.finish()
    inputs = [folder / name for name in ("cloud.parquet", "frame.json", "dem.tif")]
    kinds, out = ["tree", "guardrail", "building"], folder / "objects.parquet"
    find_roadside_objects(*inputs, kinds, BlockClasses(), out=out)
    table = read_table(out)
    return [table[table["kind"] == kind] for kind in kinds]


@pytest.mark.parametrize(("west", "east"), [(3, 6), (9, 14), (4, 24), (20, 30)])
def test_tiles_give_what_the_whole_cloud_gives(rng, tmp_path, west, east):
    trees, xyz = surveyed(rng, west, east)
    xyz = xyz.astype(np.float32).astype(np.float64)
    cls = np.where(xyz[:, 2] > 0.1, 5, 2).astype(np.uint8)
    found, rails, buildings = objects(tmp_path, xyz, cls)
    apart = np.hypot(*(trees[:, None] - found[["x", "y"]].to_numpy()).transpose(2, 0, 1))
    assert len(found) == len(trees) and (apart.min(axis=1) < 2.5).all()
    _, tile = np.unique(np.floor(xyz[:, :2] / TILE_M), axis=0, return_inverse=True)
    cell_m = canopy_cell_m([measure_density(xyz[tile.ravel() == k, :2]) for k in range(36)])
    crowns = find_crowns(xyz, xyz[:, 2], cls, cell_m)
    whole = np.column_stack([crowns.xy_m, crowns.top_m, crowns.width_m])
    columns = found[["x", "y", "top_m", "width_m"]].to_numpy()
    np.testing.assert_allclose(columns, whole[np.lexsort(whole[:, 1::-1].T)], atol=1e-6)
    trunks = find_trunks(crowns, xyz, xyz[:, 2], cls, cell_m)
    order = np.lexsort(whole[:, 1::-1].T)
    assert found["cloud_shows"].tolist() == trunks.shows[order].tolist()
    columns = found[["trunk_x", "trunk_y", "trunk_sigma_m"]].to_numpy()
    below = np.column_stack([trunks.xy_m, trunks.sigma_m])
    np.testing.assert_allclose(columns, below[order], atol=1e-6)
    assert (found["cloud_shows"] == "trunk").sum() >= (10 if west == 20 else 0)
    (line,) = join_rails(find_rail_returns(xyz, xyz[:, 2], cls))
    np.testing.assert_allclose(rails[["x", "y", "z_ground"]], line, atol=1e-6)
    assert buildings.empty


def test_a_building_in_four_tiles_is_one(rng, tmp_path):
    ground = np.column_stack([rng.uniform(0, SIZE_M, (9000, 2)), np.zeros(9000)])
    roof = np.column_stack([rng.uniform([44, 46], [57, 54], (2000, 2)), np.full(2000, 5.0)])
    wall = np.column_stack([rng.uniform(44, 57, 60), np.full(60, 46.1), rng.uniform(0.2, 5, 60)])
    cls = np.repeat([2, 6], [len(ground), len(roof) + len(wall)]).astype(np.uint8)
    trees, rails, buildings = objects(tmp_path, np.concatenate([ground, roof, wall]), cls)
    assert trees.empty and rails.empty
    assert (buildings["object"] == 0).all() and len(buildings) > 35
    assert buildings["top_m"].to_numpy() == pytest.approx(5.0, abs=0.01)
    assert buildings["x"].min() == pytest.approx(44.0, abs=0.5)
    assert buildings["y"].max() == pytest.approx(54.0, abs=0.5)
