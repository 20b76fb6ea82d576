import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.reference import UnitChoice
from roadsight.io.records.atomic import read_json, write_json
from roadsight.scene.profile import (
    count_cells,
    density,
    describe_scene,
    join_cells,
    mean_spacing_m,
    merge_counts,
    neighbour_distances,
)
from roadsight.stages.scene.ingest_cloud import ingest
from roadsight.stages.scene.profile_scene import main
from tests.helpers.las_files import DATA, needs_data, random_points, wkt_of, write_las


def classes_of(xyz, value=2):
    return np.full(len(xyz), value, np.uint8)


def slow_cells(xyz, classes):
    """Cells by a dictionary, in row-major order."""
    cells = {}
    for (x, y, z), c in zip(xyz, classes, strict=True):
        cells.setdefault((int(np.floor(y)), int(np.floor(x))), []).append((z, c))
    rows = []
    for place in sorted(cells):
        z = np.array([height for height, _ in cells[place]])
        rise = z - z.min()
        covered = (rise > 3).any() and not ((rise > 1) & (rise <= 3)).any()
        rows.append((*place, len(z), z.min(), covered, {c for _, c in cells[place]}))
    return rows


def test_cells_equal_the_slow_definition():
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-6, 6, (400, 3))
    classes = rng.choice([1, 2, 6, 26], 400).astype(np.uint8)
    cells = count_cells(xyz, classes)
    slow = slow_cells(xyz, classes)
    np.testing.assert_array_equal(cells.row, [row[0] for row in slow])
    np.testing.assert_array_equal(cells.column, [row[1] for row in slow])
    np.testing.assert_array_equal(cells.count, [row[2] for row in slow])
    np.testing.assert_allclose(cells.lowest_m, [row[3] for row in slow])
    np.testing.assert_array_equal(cells.covered, [row[4] for row in slow])
    for c in (1, 2, 6, 26):
        assert cells.class_cells[c] == sum(c in row[5] for row in slow)
    assert 0 < cells.covered.sum() < len(slow)


def test_cells_do_not_depend_on_tiles():
    rng = np.random.default_rng(1)
    xyz = rng.uniform(0, 8, (900, 3)).astype(np.float32)
    whole = count_cells(xyz, classes_of(xyz))
    halves = [xyz[xyz[:, 1] < 4], xyz[xyz[:, 1] >= 4]]
    joined = join_cells([count_cells(half, classes_of(half)) for half in halves])
    for name in ("column", "row", "count", "lowest_m", "covered"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))
    assert joined.class_cells == whole.class_cells


@pytest.mark.parametrize(
    ("heights", "covered"),
    [
        ([0, 0.1, 5.2, 5.3], True),  # deck above a road
        ([0, 0.1, 1.5, 2.5, 5.3], False),  # wall, tree with undergrowth
        ([0, 2.0, 9.0], False),  # traffic sign below a wire
        ([0, 0.5, 3.0], False),  # exactly the clearance
        ([0, 1.0, 3.01], True),  # exactly the band
        ([7.0], False),
    ],
)
def test_overhead_cover(heights, covered):
    xyz = np.array([(0.5, 0.5, z) for z in heights])
    assert count_cells(xyz, classes_of(xyz)).covered.tolist() == [covered]


@pytest.mark.parametrize("per_m2", [0.02, 0.2, 1.0, 8.0, 60.0])
def test_density_is_right_for_sparse_and_dense_clouds(per_m2):
    side_m = (20_000 / per_m2) ** 0.5
    xyz = np.random.default_rng(0).uniform(0, 1, (20_000, 3)) * (side_m, side_m, 1)
    cells = count_cells(xyz, classes_of(xyz))
    found = density(cells.column, cells.row, cells.count)
    assert found["median"] == pytest.approx(per_m2, rel=0.25)
    assert found["p05"] < found["median"] < found["p95"]
    assert found["area_m2"] == pytest.approx(side_m**2, rel=0.2)


def test_density_of_one_point():
    cells = count_cells(np.zeros((1, 3)), np.zeros(1, np.uint8))
    assert density(cells.column, cells.row, cells.count)["median"] == 1


def test_merge_counts():
    places = np.array([[3, 1, 3, 1, 2], [0, 5, 0, 4, 0]])
    distinct, count = merge_counts(places, np.array([1, 2, 3, 4, 5]))
    assert distinct.T.tolist() == [[1, 4], [1, 5], [2, 0], [3, 0]]
    assert count.tolist() == [4, 2, 5, 4]
    empty, none = merge_counts(np.empty((2, 0), np.int64), np.empty(0, np.int64))
    assert (empty.shape, len(none)) == ((2, 0), 0)


def test_neighbour_distances_equal_brute_force():
    xyz = np.random.default_rng(0).uniform(0, 1, (200, 3))
    core = xyz[:, 0] < 0.5
    pairs = np.linalg.norm(xyz[:, None] - xyz[None], axis=2)
    np.fill_diagonal(pairs, np.inf)
    found = np.sort(neighbour_distances(xyz, core))
    np.testing.assert_allclose(found, np.sort(pairs.min(axis=1)[core]))


def test_duplicates_are_one_place():
    grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3)
    doubled = np.repeat(grid, 3, axis=0)
    assert set(neighbour_distances(doubled, np.ones(len(doubled), bool))) == {1.0}
    assert len(neighbour_distances(np.zeros((4, 3)), np.ones(4, bool))) == 0
    assert len(neighbour_distances(np.zeros((0, 3)), np.ones(0, bool))) == 0


@pytest.mark.parametrize("spacing_m", [0.05, 0.5, 4.0])
def test_spacing_of_a_grid(spacing_m):
    axis = np.arange(120) * spacing_m
    x, y = np.meshgrid(axis, axis)
    xyz = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    assert mean_spacing_m(xyz) == pytest.approx(spacing_m)


def test_spacing_of_random_points():
    """Mean nearest distance in space is about 0.554 n^(-1/3); its median lies close by."""
    xyz = np.random.default_rng(0).uniform(0, 20, (30_000, 3))
    assert mean_spacing_m(xyz) == pytest.approx(0.55 * (30_000 / 8000) ** (-1 / 3), rel=0.05)


def test_profile_needs_two_places():
    with pytest.raises(InputError, match="different places"):
        mean_spacing_m(np.ones((5, 3)))
    cells = count_cells(np.zeros((1, 3)), np.zeros(1, np.uint8))
    with pytest.raises(InputError, match="different places"):
        describe_scene(cells, np.empty(0), [0] * 6, np.ones(65536, int), False)


def scene():
    """A sloping road with a bridge over a tenth of it."""
    rng = np.random.default_rng(0)
    road = rng.uniform(0, 1, (20_000, 3)) * (100, 20, 0.0)
    road[:, 2] = 0.1 * road[:, 0]
    deck = rng.uniform(0, 1, (4_000, 3)) * (10, 20, 0.05) + (40, 0, 12.0)
    xyz = np.round(np.concatenate([road, deck]), 3)
    return xyz, np.repeat([2, 17], [20_000, 4_000]).astype(np.uint8)


def ingested(tmp_path, xyz, tile_size_m, **dims):
    path = write_las(
        tmp_path / "a.laz", xyz + np.array([458000, 5428000, 0]), wkt_of("EPSG:25832"), **dims
    )
    files = tmp_path / "cloud.parquet", tmp_path / "frame.json"
    ingest([path], UnitChoice(), None, tile_size_m, *files)
    return files


def profile_of(tmp_path, files):
    out = tmp_path / "profile.json"
    options = ["--cloud", str(files[0]), "--frame", str(files[1]), "--out", str(out)]
    assert main(options) == 0
    return read_json(out)


@pytest.mark.parametrize("tile_size_m", [10, 50])
def test_profile_of_a_known_scene(tmp_path, tile_size_m):
    xyz, classes = scene()
    rng = np.random.default_rng(0)
    files = ingested(
        tmp_path, xyz, tile_size_m, classification=classes, intensity=rng.integers(0, 99, len(xyz))
    )
    profile = profile_of(tmp_path, files)
    assert profile["points"] == 24_000
    assert profile["area_m2"] == pytest.approx(2000, rel=0.05)
    assert profile["density_per_m2"]["median"] == pytest.approx(10, rel=0.1)
    everywhere = neighbour_distances(xyz, np.ones(len(xyz), bool))
    assert profile["spacing_m"] == pytest.approx(np.median(everywhere), rel=0.07)
    assert mean_spacing_m(xyz) == pytest.approx(np.median(everywhere), rel=0.07)
    assert profile["extent_m"] == pytest.approx([100, 20, 12.05], abs=0.1)
    assert profile["relief_m"] == pytest.approx(9.0, abs=0.3)
    assert profile["overhead_cover_share"] == pytest.approx(0.1, abs=0.015)
    assert profile["class_shares"]["17"] == pytest.approx(0.1, abs=0.015)
    assert profile["class_shares"]["2"] == pytest.approx(1.0, abs=0.01)
    assert profile["slope_deg"]["median"] == pytest.approx(np.degrees(np.arctan(0.1)), abs=0.2)
    # The deck spans 10 m by 20 m; its border is a cell wide.
    assert profile["cover_core_m2"] == pytest.approx(8 * 18, abs=25)
    assert profile["intensity"]["median"] == pytest.approx(49, abs=2)
    assert profile["has_intensity"]
    assert not profile["has_colour"]


def test_profile_does_not_depend_on_the_tiles(tmp_path):
    xyz, classes = scene()
    profiles = []
    for size in (10, 50):
        files = ingested(tmp_path, xyz, size, classification=classes)
        profiles.append(profile_of(tmp_path, files))
    spacing = [profile.pop("spacing_m") for profile in profiles]
    assert profiles[0] == profiles[1]
    assert spacing[0] == pytest.approx(spacing[1], rel=0.05)  # another sample of points


def test_bad_input_of_the_stage(tmp_path, capsys):
    files = ingested(tmp_path, random_points(20, corner=(0, 0, 0)), 50)
    about = read_json(files[1])
    write_json(files[1], about | {"points": 21})
    out = tmp_path / "profile.json"
    options = ["--cloud", str(files[0]), "--frame", str(files[1]), "--out", str(out)]
    assert main(options) == 2
    assert "of another cloud" in capsys.readouterr().err
    files = ingested(tmp_path, np.ones((3, 3)), 50)
    assert main(options) == 2
    assert "different places" in capsys.readouterr().err
    assert not out.exists()


@needs_data
def test_real_profile(tmp_path):
    files = tmp_path / "cloud.parquet", tmp_path / "frame.json"
    cloud = DATA / "clouds" / "montpellier_street.laz"
    ingest([cloud], UnitChoice(), None, 50, *files)
    profile = profile_of(tmp_path, files)
    assert profile["density_per_m2"]["median"] == pytest.approx(28, rel=0.15)
    assert set(profile["class_shares"]) == set("0123456")
    assert 0.1 < profile["spacing_m"] < 0.2
