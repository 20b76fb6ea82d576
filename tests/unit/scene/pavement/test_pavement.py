import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, box

from roadsight.base.errors import InputError
from roadsight.base.sections.scene import PavementOutline
from roadsight.geometry.areas import inside
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.fpfh import (
    column_means,
    fit_smoothness,
    fpfh,
    is_smooth,
    nearest_neighbours,
    upward_normals,
)
from roadsight.scene.pavement.outline import outline_pavement, pavement_settings_for, vote

SETTINGS = PavementOutline()


def raster_of(shape, rng, step_m=0.1, jitter_m=0.04):
    """One point per column inside a shape, like thinned ground, all at height 0."""
    west, south, east, north = shape.bounds
    x, y = np.meshgrid(np.arange(west, east, step_m), np.arange(south, north, step_m))
    xy = np.column_stack([x.ravel(), y.ravel()]) + step_m / 2
    xy += rng.uniform(-jitter_m, jitter_m, xy.shape)
    xy = xy[shapely.contains_xy(shape, *xy.T)]
    return np.column_stack([xy, np.zeros(len(xy))])


def all_smooth(xyz, settings=SETTINGS):
    return outline_pavement(xyz, np.ones(len(xyz), bool), settings)


def road_in_rough_ground(rng, road):
    """1 cm noise on the road, 5 cm around it; the road is crowned and on a grade."""
    x, y = rng.uniform(0, 30, (2, 30 * 30 * 130))
    on_road = shapely.contains_xy(road, x, y)
    z = 0.03 * y - 0.02 * np.abs(x - 15) + rng.normal(0, 1, len(x)) * np.where(on_road, 0.01, 0.05)
    return np.column_stack([x, y, z])


def test_a_smooth_road_is_found_in_rough_ground(rng):
    road = box(9.0, 0.0, 20.0, 30.0)
    xyz, _, _ = column_means(road_in_rough_ground(rng, road), np.empty((117_000, 0)), 0.1)
    distance, near = nearest_neighbours(xyz, 10)
    normals, variation = upward_normals(xyz, near)
    histograms = fpfh(xyz, normals, distance, near)
    sample = rng.choice(len(xyz), 10_000, replace=False)
    model = fit_smoothness(histograms[sample], variation[sample], None, 1.5, 1)
    smooth = is_smooth(model, histograms, variation, np.zeros(len(xyz)))
    outline = outline_pavement(xyz, smooth, SETTINGS)
    found, true = (
        inside(MultiPolygon([*shapely.get_parts(s)]), *xyz[:, :2].T) for s in (outline, road)
    )
    assert (found & true).sum() / true.sum() > 0.95
    assert (found & true).sum() / found.sum() > 0.95
    assert outline.is_valid
    assert len(outline.geoms) == 1


PUBLISHED = PavementOutline(
    vote_radius_m=0, closing_m=0, smallest_hole_m2=0, smallest_part_share=1, outline_cell_m=0.2
)


class TestWithoutAdditions:
    """The published clustering: no vote, no closing, distances as they are set."""

    def test_a_stray_rough_point_stays_out_and_a_gap_stays_open(self, rng):
        xyz = raster_of(box(0, 0, 30, 12), rng)
        smooth = ~((np.abs(xyz[:, 0] - 15) < 0.5) & (np.abs(xyz[:, 1] - 6) < 0.5))
        published = outline_pavement(xyz, smooth, PUBLISHED)
        assert not shapely.contains_xy(published, 15, 6)
        assert shapely.contains_xy(outline_pavement(xyz, smooth, SETTINGS), 15, 6)

    def test_there_is_one_cluster(self, rng):
        xyz = raster_of(shapely.union_all([box(0, 0, 40, 8), box(0, 12, 40, 19)]), rng)
        found = all_smooth(xyz, PUBLISHED)
        assert found.bounds[3] < 8.3
        assert all_smooth(xyz).bounds[3] > 18.5

    def test_voxels_leave_distances_as_they_are_set(self):
        assert pavement_settings_for(0.1, PUBLISHED, "voxels") == PUBLISHED
        raised = pavement_settings_for(0.1, PUBLISHED, "columns")
        assert raised.cluster_distance_m == 0.25
        assert raised.vote_radius_m == raised.closing_m == 0

    def test_clusters_nearer_than_the_spacing_are_refused(self):
        with pytest.raises(InputError, match=r"cluster_distance_m.*0.2 m.*at least 0.3 m"):
            pavement_settings_for(0.3, PUBLISHED, "voxels")


def test_outline_of_a_rectangle_lies_within_a_cell(rng):
    true = box(3.2, -7.4, 33.7, 4.9)
    found = all_smooth(raster_of(true, rng))
    assert len(found.geoms) == 1
    assert found.hausdorff_distance(true) < SETTINGS.closing_m / 2 * 0.42 + 0.25  # rounded corners
    middle = shapely.segmentize(found.boundary, 0.2)
    points = shapely.get_coordinates(middle)
    corners = shapely.points(shapely.get_coordinates(true.exterior))
    far = np.array([shapely.distance(corners, p).min() > 1 for p in shapely.points(points)])
    off = shapely.distance(shapely.points(points[far]), true.boundary)
    assert off.max() <= SETTINGS.outline_cell_m + 1e-6
    assert found.area == pytest.approx(true.area, rel=0.03)


def test_a_curved_road_keeps_its_shape(rng):
    arc = shapely.Point(0, 0).buffer(60, quad_segs=90).difference(shapely.Point(0, 0).buffer(49))
    true = arc.intersection(box(0, 0, 70, 70))
    found = all_smooth(raster_of(true, rng))
    assert found.symmetric_difference(true).area < 0.03 * true.area


def test_small_holes_are_filled_and_large_ones_kept(rng):
    small, large = box(5, 5, 9, 9), box(15, 3, 22, 9)  # 16 and 42 m2
    found = all_smooth(raster_of(box(0, 0, 30, 12).difference(small.union(large)), rng))
    assert shapely.contains_xy(found, 7, 7)
    assert not shapely.contains_xy(found, 18, 6)
    [polygon] = found.geoms
    assert len(polygon.interiors) == 1
    assert shapely.Polygon(polygon.interiors[0]).area == pytest.approx(large.area, rel=0.15)


def test_narrow_gaps_are_closed(rng):
    joint = box(14.6, 0, 15.2, 12)
    settings = PavementOutline(cluster_distance_m=0.7)
    found = all_smooth(raster_of(box(0, 0, 30, 12).difference(joint), rng), settings)
    assert shapely.contains_xy(found, 14.9, 6)


def test_whiskers_are_cut(rng):
    whisker = box(30, 5, 36, 5.6)
    found = all_smooth(raster_of(box(0, 0, 30, 12).union(whisker), rng))
    assert found.bounds[2] < 31


def test_two_carriageways_are_kept_and_a_driveway_is_not(rng):
    roads = [box(0, 0, 40, 8), box(0, 12, 40, 19)]
    driveway = box(0, 24, 8, 30)  # 48 of 320 m2
    shapes = shapely.union_all([*roads, driveway])
    found = all_smooth(raster_of(shapes, rng))
    assert len(found.geoms) == 2
    assert found.geoms[0].area > found.geoms[1].area
    everything = all_smooth(raster_of(shapes, rng), PavementOutline(smallest_part_share=0.0))
    assert len(everything.geoms) == 3


def test_an_island_inside_a_filled_hole_leaves_a_valid_outline(rng):
    """A ring road of one cluster with an islet that touches it only corner to corner."""
    cells = np.ones((140, 140), bool)
    cells[60:76, 60:76] = False
    cells[64:72, 64:72] = True
    for k in range(4):
        cells[60 + k, 60 + k] = True
    row, column = np.nonzero(cells)
    xyz = np.column_stack([column * 0.25 + 0.125, row * 0.25 + 0.125, np.zeros(len(row))])
    settings = PavementOutline(cluster_distance_m=0.4, closing_m=0.25)
    found = all_smooth(xyz, settings)
    assert found.is_valid
    assert found.area == pytest.approx(35.0**2, rel=0.01)


def test_the_sign_of_the_coordinates_does_not_matter(rng):
    xyz = raster_of(box(0, 0, 30, 12), rng)
    here = all_smooth(xyz)
    there = all_smooth(xyz - [40, 25, 0])
    assert shapely.equals_exact(shapely.affinity.translate(here, -40, -25), there, 1e-6)


@pytest.mark.parametrize("n", [0, 1, 500])
def test_nothing_smooth_is_refused(rng, n):
    with pytest.raises(InputError, match="no smooth ground"):
        outline_pavement(rng.uniform(0, 9, (n, 3)), np.zeros(n, bool), SETTINGS)


def test_fragments_are_refused(rng):
    """One blob of 36 m2 and two hundred too small to count beside it."""
    centres = np.stack(np.meshgrid(np.arange(15), np.arange(15)), axis=-1).reshape(-1, 2) * 8.0
    small = [box(x, y, x + 2.4, y + 2.4) for x, y in centres[1:]]
    xyz = np.concatenate([raster_of(part, rng) for part in [box(0, 0, 6, 6), *small]])
    with pytest.raises(InputError, match=r"in 225 pieces; found 3% of it in the largest 1"):
        all_smooth(xyz)


def test_too_little_pavement_is_refused(rng):
    with pytest.raises(InputError, match=r"found 1\d\d m2; allowed: at least 200 m2"):
        all_smooth(raster_of(box(0, 0, 18, 10), rng))


class TestVote:
    def test_a_lonely_voice_is_outvoted(self, rng):
        xyz = raster_of(box(0, 0, 20, 10), rng)
        x, y = xyz[:, 0], xyz[:, 1]
        left = x < 10
        noisy = left ^ (rng.random(len(x)) < 0.15)
        grid = Grid.around(x, y, 0.25)
        voted = vote(grid, x, y, noisy, 0.5)
        clear = np.abs(x - 10) > 0.5
        assert (voted == left)[clear].mean() > 0.999
        assert (noisy == left)[clear].mean() < 0.87

    def test_unanimous_votes_stay(self, rng):
        x, y = rng.uniform(0, 5, (2, 300))
        grid = Grid.around(x, y, 0.25)
        assert vote(grid, x, y, np.ones(300, bool), 0.5).all()
        assert not vote(grid, x, y, np.zeros(300, bool), 0.5).any()


def test_inside_leaves_out_holes(rng):
    outline = MultiPolygon([box(0, 0, 10, 10).difference(box(4, 4, 6, 6)), box(20, 0, 30, 10)])
    found = inside(outline, np.array([1.0, 5, 15, 25]), np.array([1.0, 5, 5, 5]))
    assert found.tolist() == [True, False, False, True]
    assert inside(outline, np.empty(0), np.empty(0)).shape == (0,)
