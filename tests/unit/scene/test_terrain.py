import numpy as np
import pytest

from roadsight.base.sections.scene import GroundFilter
from roadsight.scene import whole
from roadsight.scene.terrain.terrain import TerrainModel, label_ground
from roadsight.stages.scene.build_dem import ClassAgreement, ground_doubts, raised_settings

INFINITE = (-np.inf, -np.inf, np.inf, np.inf)


def as_tiles(xyz, size_m):
    """Tiles like those of a stored cloud: half-open cores, halo on request."""

    def tiles(halo_m):
        index = np.floor(xyz[:, :2] / size_m)
        for ix, iy in np.unique(index, axis=0):
            west, south = ix * size_m, iy * size_m
            core = (west, south, west + size_m, south + size_m)
            x, y = xyz[:, 0], xyz[:, 1]
            near = (x >= west - halo_m) & (x < core[2] + halo_m)
            near &= (y >= south - halo_m) & (y < core[3] + halo_m)
            yield core, xyz[near]

    return tiles


def labels(tiles, bounds):
    parts = list(label_ground(tiles, bounds, GroundFilter()))
    xyz = np.concatenate([points for points, _ in parts])
    mask = np.concatenate([mask for _, mask in parts])
    return sorted((*point, bool(value)) for point, value in zip(xyz.tolist(), mask, strict=True))


class TestLabelGround:
    def test_tiles_give_the_labels_of_the_whole(self, plane_scene, box_shell):
        cars = [((20.0, 21.8), (4, 8.4)), ((4, 8.4), (8.9, 10.7)), ((29.6, 31.4), (29, 33.4))]
        scene = plane_scene(slope_x=0.06, density_m2=60).with_objects(
            *[box_shell(x, y, (3.25 + 0.06 * x[0], 4.5 + 0.06 * x[0]), 60) for x, y in cars],
            hidden=lambda x, y: np.any(
                [(x > a) & (x < b) & (y > c) & (y < d) for (a, b), (c, d) in cars], axis=0
            ),
        )
        whole = labels(lambda halo: iter([(INFINITE, scene.xyz_m)]), scene.bounds_m)
        tiled = labels(as_tiles(scene.xyz_m, 10.0), scene.bounds_m)
        assert len(whole) == len(scene.xyz_m)
        assert whole == tiled

    def test_each_point_is_yielded_once_even_on_a_border(self):
        xyz = np.array([[0.0, 0.0, 1.0], [10.0, 0.0, 1.0], [10.0, 10.0, 1.0], [9.999, 5.0, 1.0]])
        found = labels(as_tiles(xyz, 10.0), (0.0, 0.0, 10.0, 10.0))
        assert found == sorted((*point, True) for point in xyz.tolist())


class TestTerrainModel:
    def test_heights_are_means_from_all_tiles(self):
        terrain = TerrainModel((0.0, 0.0, 1.9, 0.9), 1.0)
        terrain.add(np.array([[0.5, 0.5, 1.0], [1.5, 0.5, 5.0]]))
        terrain.add(np.array([[0.2, 0.9, 2.0]]))
        assert terrain.heights_m(1.0).tolist() == [[1.5, 5.0]]

    def test_first_row_is_the_southern_one(self):
        terrain = TerrainModel((0.0, 0.0, 0.5, 1.5), 1.0)
        terrain.add(np.array([[0.5, 0.5, 1.0], [0.5, 1.5, 2.0]]))
        assert terrain.heights_m(1.0).tolist() == [[1.0], [2.0]]

    def test_gaps_follow_the_slope_of_the_ground_around(self, plane_scene):
        scene = plane_scene(slope_x=0.05, noise_m=0.0, density_m2=30)
        x, y = scene.xyz_m[:, 0], scene.xyz_m[:, 1]
        terrain = TerrainModel(scene.bounds_m, 0.5)
        terrain.add(scene.xyz_m[np.hypot(x - 20, y - 20) > 5])
        heights = terrain.heights_m(20.0)
        columns, rows = np.meshgrid(np.arange(terrain.grid.columns), np.arange(terrain.grid.rows))
        true = scene.surface(*terrain.grid.centres(columns, rows))
        assert np.isfinite(heights).all()
        assert np.abs(heights - true).max() < 0.15

    def test_further_than_the_fill_distance_there_is_no_height(self):
        terrain = TerrainModel((0.0, 0.0, 29.9, 29.9), 1.0)
        terrain.add(np.array([[15.5, 15.5, 7.0]]))
        heights = terrain.heights_m(5.0)
        rows, columns = np.indices(heights.shape)
        distance = np.hypot(rows - 15, columns - 15)
        assert np.isnan(heights[distance > 5.01]).all()
        assert (heights[distance < 4.0] == 7.0).all()

    def test_without_ground_there_is_no_height(self):
        terrain = TerrainModel((0.0, 0.0, 2.9, 1.9), 1.0)
        terrain.add(np.empty((0, 3)))
        assert np.isnan(terrain.heights_m(5.0)).all()
        assert terrain.heights_m(5.0).shape == (2, 3)

    def test_single_precision_keeps_the_millimetre_at_4000_m(self, rng):
        terrain = TerrainModel((0.0, 0.0, 19.9, 19.9), 1.0)
        x, y = np.indices((20, 20)).reshape(2, -1) + 0.5
        z = 4000.0 + rng.uniform(0, 1, 400)
        terrain.add(np.column_stack([x, y, z]))
        assert np.abs(terrain.heights_m(1.0).T.ravel() - z).max() < 0.001

    def test_order_of_the_tiles_does_not_matter(self, rng):
        xyz = rng.uniform(0, 10, (500, 3))
        first, second = (TerrainModel((0.0, 0.0, 10.0, 10.0), 1.0) for _ in range(2))
        for part in (xyz[:100], xyz[100:]):
            first.add(part)
        for part in (xyz[100:], xyz[:100]):
            second.add(part)
        np.testing.assert_allclose(first.heights_m(3.0), second.heights_m(3.0), atol=1e-6)


class TestWhatTheTerrainRestsOn:
    def test_noise_is_the_spread_of_cells(self, plane_scene):
        scene = plane_scene(noise_m=0.03, density_m2=200)
        terrain = TerrainModel(scene.bounds_m, 0.5)
        terrain.add(scene.xyz_m)
        assert terrain.noise_m() == pytest.approx(0.03, rel=0.1)
        assert np.isnan(TerrainModel(scene.bounds_m, 0.5).noise_m())

    def test_gaps_inside_are_filled_and_the_surroundings_do_not_count(self):
        terrain = TerrainModel((0.0, 0.0, 99.9, 99.9), 1.0)
        x, y = np.meshgrid(np.arange(20) + 0.5, np.arange(20) + 0.5)
        road = np.column_stack([x.ravel(), y.ravel(), np.zeros(400)])
        terrain.add(road[np.abs(road[:, :2] - 10).max(axis=1) > 2])
        assert terrain.filled_share() == pytest.approx(16 / 400)
        assert terrain.measured.sum() == 384

    def test_classes_that_geometry_contradicts_are_doubted(self):
        classes = ClassAgreement()
        above = np.where(np.arange(100) < 50, 0.0, 4.0)
        classes.add(np.full(100, 2, np.uint8), above == 0, above)
        codes = {d.code: d.severity for d in ground_doubts(0.5, 0.0, 0.08, classes)}
        assert codes["classes_contradict"] == codes["layer_noise"] == "doubt"
        agree = ClassAgreement()
        agree.add(np.full(100, 2, np.uint8), np.ones(100, bool), np.zeros(100))
        assert {d.severity for d in ground_doubts(0.5, 0.0, 0.01, agree)} == {"note"}

    def test_raised_settings_are_told(self):
        [note] = raised_settings({"a": 1.0, "b": 2.0}, {"a": 1.5, "b": 2.0})
        assert (note.code, note.measured, note.limit) == ("raised_a", 1.5, 1.0)


def test_a_wide_cloud_is_labelled_in_tiles_with_the_same_labels(plane_scene, monkeypatch):
    scene = plane_scene(side_m=60, slope_x=0.05, density_m2=20)
    one = whole.ground_of(scene.xyz_m)
    monkeypatch.setattr(whole, "_LARGEST_TILE_M", 40.0)
    assert (whole.ground_of(scene.xyz_m) == one).all()


@pytest.mark.real
@pytest.mark.parametrize(
    ("file", "largest_error", "largest_false_ground"),
    [
        ("montpellier_street.laz", 0.018, 0.021),
        ("amsterdam_poles/cloud.laz", 0.008, 0.014),
        ("delft/cloud.laz", 0.019, 0.022),
    ],
)
def test_published_classifications_are_met(data, rng, file, largest_error, largest_false_ground):
    import laspy

    cloud = laspy.read(data / "clouds" / file)
    true = np.asarray(cloud.classification) == 2
    for shift in rng.uniform(0, 1, (2, 3)):  # wherever the grid lies
        xyz = cloud.xyz - cloud.xyz.min(axis=0) + shift
        bounds = (*xyz[:, :2].min(axis=0), *xyz[:, :2].max(axis=0))
        settings = GroundFilter()
        [(_, found)] = label_ground(lambda halo, xyz=xyz: iter([(INFINITE, xyz)]), bounds, settings)
        assert (found != true).mean() < largest_error
        assert found[~true].mean() < largest_false_ground
