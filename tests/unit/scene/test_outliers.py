import numpy as np
import pytest

from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_about
from roadsight.scene.surfels import in_company
from roadsight.stages.scene import build_surfels
from tests.helpers.engines import needs_open3d


def by_definition(xyz, around, radius, others):
    both = np.concatenate([xyz, around])
    apart = np.linalg.norm(both[: len(xyz), None] - both[None], axis=2)
    return (apart < radius).sum(axis=1) - 1 >= others


@pytest.mark.parametrize("others", [1, 2, 5])
def test_as_by_definition(rng, others):
    xyz, around = rng.uniform(0, 5, (300, 3)), rng.uniform(4, 9, (200, 3))
    expected = by_definition(xyz, around, 0.6, others)
    assert (in_company(xyz, around, 0.6, others) == expected).all()


def test_points_around_count_but_are_not_judged():
    lone, beside = np.array([[0.0, 0, 0]]), np.array([[0.1, 0, 0], [0, 0.1, 0]])
    assert in_company(lone, beside, 0.5, 2).tolist() == [True]
    assert in_company(lone, beside, 0.5, 3).tolist() == [False]


def test_one_point_and_none():
    nothing = np.empty((0, 3))
    assert in_company(nothing, nothing, 0.5, 1).shape == (0,)
    assert in_company(np.zeros((1, 3)), nothing, 0.5, 1).tolist() == [False]


def test_points_at_one_place_are_company():
    assert in_company(np.zeros((3, 3)), np.empty((0, 3)), 0.5, 2).all()


@pytest.fixture(scope="module")
def birds(tmp_path_factory):
    """Ground of 30 m by 6 m in tiles of 10 m and 20 birds above it."""
    rng, folder = np.random.default_rng(3), tmp_path_factory.mktemp("birds")
    ground = rng.uniform((0, 0, 0), (30, 6, 0.02), (20_000, 3))
    air = np.column_stack([np.arange(0.5, 30, 1.5), np.full(20, 3.0), np.full(20, 8.0)])
    points = np.concatenate([ground, air]).astype(np.float32)
    ones = np.ones(len(points), np.uint8)
    with TileWriter(folder / "cloud.parquet", 10.0, coloured=False) as writer:
        counts = dict.fromkeys(("classification", "return_number", "number_of_returns"), ones)
        writer.append(dict(zip("xyz", points.T, strict=True)) | {"intensity": ones} | counts)
        writer.finish()
    return folder


def surfels_of(folder, *options):
    out = str(folder / "surfels.parquet")
    assert (
        build_surfels.main(["--cloud", str(folder / "cloud.parquet"), "--out", out, *options]) == 0
    )
    return read_surfels(out), read_about(out)


def test_birds_become_no_surfels_and_ground_at_the_border_of_a_tile_stays(birds, caplog):
    caplog.set_level("WARNING")
    whole, about = surfels_of(birds)
    assert about["points"] == 20_020
    assert (whole.centre_m[:, 2] > 5).sum() == 20 * 3  # three crossed squares each
    freed, about = surfels_of(birds, "--outlier-radius-m", "0.5")
    assert about["points"] == 20_000
    assert not (freed.centre_m[:, 2] > 5).any()
    assert (whole.centre_m[:, 2] < 5).sum() == len(freed)
    assert not caplog.records


def test_a_radius_that_takes_surfaces_is_told(birds, caplog):
    surfels_of(birds, "--outlier-radius-m", "0.05")
    assert "surfaces are lost" in caplog.text


def test_open3d_leaves_the_same_surfels(birds):
    needs_open3d()
    options = ("--outlier-radius-m", "0.5", "--outlier-engine")
    own, peer = (surfels_of(birds, *options, engine)[0] for engine in ("own", "open3d"))
    np.testing.assert_array_equal(own.centre_m, peer.centre_m)
