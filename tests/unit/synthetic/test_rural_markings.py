import numpy as np
import pytest

from roadsight.base.kernels import compiled
from roadsight.base.sections.run import RuralScene
from roadsight_worlds.rural.rural_ground import LANE_M
from roadsight_worlds.rural.rural_markings import HATCH_M, line_cover
from roadsight_worlds.rural.rural_materials import Ground
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.rural_surface import ground_kinds
from roadsight_worlds.rural.rural_truth import rural_layers
from roadsight_worlds.rural.videolog import random_drives, shots
from roadsight_worlds.rural.videolog_tables import pole_table


def built(**scene):
    return build_rural(3, 300.0, detail=0.02, scene=RuralScene(**scene))


@pytest.fixture(scope="module")
def four():
    return built(lanes=2, flush_verges=True)


@compiled()
def mean_cover(paint, station, across):
    """White and yellow share of a road's section."""
    white, yellow = 0.0, 0.0
    for k in range(1400):
        of_white, of_yellow = line_cover(paint, station, 0.01 * k - 7.0, across)
        white += of_white / 1400
        yellow += of_yellow / 1400
    return white, yellow


def kinds_at(site, station, offset):
    road = np.stack(np.broadcast_arrays(station, offset), axis=-1).reshape(-1, 2)
    return ground_kinds(site.surface, site.line.plan(*road.T), road)


def open_stations(site):
    """Stations every 5 cm without side road, bridge or hatching."""
    station = np.arange(5.0, 295.0, 0.05)
    away = np.abs(station - site.ground.gully_m) > 8.0
    for _, first, last in site.surface.paint.gap:
        away &= (station < first) | (station > last)
    for first, last in site.surface.paint.hatched:
        away &= (station < first) | (station > last)
    return station[away]


def test_the_usual_road_is_what_it_was():
    site = build_rural(3, 300.0, detail=0.02)
    road = np.random.default_rng(0).uniform([0.0, -6.0], [300.0, 6.0], (50_000, 2))
    kinds = ground_kinds(site.surface, site.line.plan(*road.T), road)
    # Counted before roads had more lanes.
    assert np.bincount(kinds).tolist() == [9460, 9644, 26195, 405, 327, 296, 1046, 809, 1818]
    middle = [-27.070210054947797, 150.32069564509877, 10.566303815707016]
    np.testing.assert_allclose(site.mesh.vertices_m.mean(axis=0), middle, atol=1e-6)
    first = [shot.cameras["front"].position_m for shot in shots(site, random_drives(3)[0], 3)]
    middle = [-28.308593370818084, 143.3644518681746, 1.8526382137402624]
    np.testing.assert_allclose(np.mean(first, axis=0), middle, atol=1e-6)


def test_lines_of_four_lanes_are_where_they_should_be(four):
    station = open_stations(four)
    for side in (-1.0, 1.0):
        edge = kinds_at(four, station, side * (2 * LANE_M - 0.06))
        assert (edge == Ground.WHITE_LINE).all()
        lane_line = kinds_at(four, station, side * LANE_M) == Ground.WHITE_LINE
        assert lane_line.mean() == pytest.approx(0.25, abs=0.03)
        assert np.diff(station[lane_line]).max() >= 9.0
        assert (kinds_at(four, station, side * 0.11) == Ground.YELLOW_LINE).all()
        bare = kinds_at(four, station, side * (LANE_M + 0.3))
        assert (bare == Ground.ROAD).all()


def test_arrows_point_where_traffic_goes(four):
    for lane in (0.5, 1.5):
        for side, way in ((-1.0, 1.0), (1.0, -1.0)):
            tip = 45.8 if way > 0 else 40.2
            offset = side * LANE_M * lane
            painted = kinds_at(four, [tip, tip - way * 2.0, tip - way * 5.0], offset)
            assert (painted == Ground.WHITE_LINE).all()
            wide = kinds_at(four, [tip - way * 2.0, tip - way * 5.0], offset + 0.45)
            assert wide.tolist() == [Ground.WHITE_LINE, Ground.ROAD]
            assert kinds_at(four, [50.0, 79.0], offset).tolist() == [Ground.ROAD] * 2


def test_hatching_lies_inside_the_edge_lines_of_its_stretches(four):
    across = np.arange(0.15, HATCH_M - 0.15, 0.05)
    for first, last in four.surface.paint.hatched:
        station = np.arange(first + 0.5, last - 0.5, 0.05)
        grid = np.meshgrid(station, LANE_M * 2 - across, indexing="ij")
        keep = ~np.isin(np.floor(grid[0]), open_stations(four))
        kinds = kinds_at(four, *grid)[keep.ravel()]
        share = (kinds == Ground.WHITE_LINE).mean()
        assert share == pytest.approx(0.25, abs=0.05)


def test_paint_seen_from_afar_is_its_share_from_near(four):
    for station in (13.0, 42.0, 45.0, 175.3, 180.0):
        near, far = (mean_cover(four.surface.paint, station, across) for across in (0.0, 0.4))
        np.testing.assert_allclose(near, far, atol=0.02)


def test_tables_and_drives_belong_to_the_wide_road(four):
    half = four.ground.section.pavement_m
    assert 2 * LANE_M + 0.25 <= half <= 2 * LANE_M + 0.5
    edges = rural_layers(four)["edges"].set_index("kind").geometry
    assert edges["left"].distance(edges["right"]) == pytest.approx(2 * half, abs=0.01)
    poles = pole_table(four)
    usual = pole_table(built())
    assert poles["edge_distance_m"].min() > 0.5
    assert poles["kind"].value_counts()["utility"] == usual["kind"].value_counts()["utility"]
    for drive in random_drives(3):
        places = [shot.cameras["front"].position_m[:2] for shot in shots(four, drive, 3)]
        offset = four.line.road(places)[:, 1]
        assert np.abs(offset - (-1.5 if drive.forward else 1.5) * LANE_M).max() < 0.3


def test_flush_verges_are_level_with_the_shoulder(four):
    station = open_stations(four)[::100]
    for site, least, most in ((four, 0.0, 0.2), (built(lanes=2), 0.6, 0.9)):
        section = site.ground.section
        beside = site.ground.height(station, section.shoulder_m + 1.8)
        drop = site.ground.height(station, section.pavement_m) - beside
        assert least < np.median(drop) < most


def test_worn_paint_is_gone_in_pieces():
    sound, worn = built(lanes=2), built(lanes=2, worn_markings=0.3)
    station = open_stations(sound)
    for offset in (0.11, 2 * LANE_M - 0.06, -(2 * LANE_M - 0.06)):
        gone = kinds_at(worn, station, offset) == Ground.ROAD
        assert gone.mean() == pytest.approx(0.3, abs=0.17)
        assert not (kinds_at(sound, station, offset) == Ground.ROAD).any()
    bare = built(lanes=2, worn_markings=1.0)
    kinds = kinds_at(bare, *np.meshgrid(station[::7], np.arange(-7.0, 7.0, 0.1)))
    assert not np.isin(kinds, (Ground.WHITE_LINE, Ground.YELLOW_LINE)).any()
