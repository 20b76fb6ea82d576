from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS, Geod

from roadsight.base.sections.poles import Reach
from roadsight.base.sections.run import RuralScene
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.geometry.frames import Frame
from roadsight.geometry.lens import RadialLens
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.alignment.drive import near_edges, places_of
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.stages.poles import rate_hazard
from roadsight.stages.poles.rate_hazard import grid_scale
from roadsight.stages.poles.shared.alignment_inputs import lowered
from roadsight_worlds.rendering.images import Camera, Finish, RuralRenderer
from roadsight_worlds.rendering.rendering_look import drive_look
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives
from tests.helpers.road_bed import RoadBed, frames_of

MERCATOR = Frame((0.0, 6_600_000.0, 0.0), 1.0, 1.0, CRS.from_epsg(3857).to_wkt())


class TestScale:
    @pytest.mark.parametrize(
        ("epsg", "origin"), [(32632, (300_000.0, 5_428_000.0, 0.0)), (2154, (770_000.0, 6.28e6, 0))]
    )
    def test_is_grid_length_over_geodesic_length(self, epsg, origin):
        crs = CRS.from_epsg(epsg)
        north = SiteNorth(Frame(origin, 1.0, 1.0, crs.to_wkt()))
        ends = np.array([[0.0, 0.0], [300.0, 400.0]])
        latitude, longitude = north.to_geographic(ends)
        ellipsoid = crs.ellipsoid
        geod = Geod(a=ellipsoid.semi_major_metre, rf=ellipsoid.inverse_flattening)
        length = geod.inv(longitude[0], latitude[0], longitude[1], latitude[1])[2]
        assert north.scale(ends).mean() == pytest.approx(500.0 / length, abs=2e-7)

    def test_of_poles(self):
        poles = pd.DataFrame({"x": [0.0, 50.0], "y": [0.0, 80.0]})
        latitude = np.radians(SiteNorth(MERCATOR).to_geographic(poles.to_numpy())[0].mean())
        assert grid_scale(poles, MERCATOR) == pytest.approx(1 / np.cos(latitude), rel=3e-3)
        assert grid_scale(poles.iloc[:0], MERCATOR) == 1.0
        assert grid_scale(poles, Frame((0, 0, 0))) == 1.0

    def rated(self, folder, scale, decision):
        """Hazard that the stage writes for one road, in a grid of that scale."""
        folder.mkdir()
        write_json(folder / "frame.json", MERCATOR.to_dict())
        edges = np.column_stack([np.arange(-50, 250, 0.25), np.full(1200, 4.0), np.zeros(1200)])
        edges = np.concatenate([edges, edges * [1, -1, 1]])
        write_table(folder / "edges.parquet", pd.DataFrame(scale * edges, columns=list("xyz")))
        track = pd.DataFrame({"x": scale * np.arange(0.0, 200.0, 8.0), "y": 0.0})
        write_table(folder / "frames.parquet", track.assign(route="r", sequence=range(25)))
        y = np.arange(20, -20, -0.5) - 0.25
        slope = np.repeat(-0.1 * np.abs(y)[:, None], 600, axis=1)
        corner = (-50.0 * scale, 20.0 * scale)
        write_raster(folder / "dem.tif", slope, MERCATOR, *corner, 0.5 * scale)
        poles = pd.DataFrame({"x": [60.0, 100.0], "y": [9.0, -7.2], "sigma_major_m": [0.2, 0.3]})
        latitude, longitude = SiteNorth(MERCATOR).to_geographic(
            scale * poles[["x", "y"]].to_numpy()
        )
        poles = (scale * poles).assign(
            id=["p", "q"], kind="pole", kept=True, latitude=latitude, longitude=longitude
        )
        write_table(folder / "poles.parquet", poles)
        files = ("frame.json", "frames.parquet", "edges.parquet", "poles.parquet")
        arguments = [f"--{Path(name).stem}={folder / name}" for name in files]
        arguments += [f"--dem={folder / 'dem.tif'}", f"--scale-factor={decision}"]
        out = folder / "hazard.parquet"
        assert rate_hazard.main([*arguments, f"--out={out}", f"--csv={folder / 'h.csv'}"]) == 0
        return read_table(out)

    def test_the_rating_is_that_on_the_ground_whatever_the_grid(self, tmp_path):
        poles = pd.DataFrame({"x": [60.0, 100.0], "y": [9.0, -7.2]})
        scale = grid_scale(poles, MERCATOR)
        assert scale > 1.5
        expected = self.rated(tmp_path / "ground", 1.0, "skip")
        found = self.rated(tmp_path / "grid", scale, "simulate")
        places = ["x", "y", "latitude", "longitude"]
        pd.testing.assert_frame_equal(
            found.drop(columns=places), expected.drop(columns=places), rtol=1e-3, atol=1e-3
        )
        assert expected["offset_m"].tolist() == pytest.approx([5.0, 3.2], abs=0.02)
        ignored = self.rated(tmp_path / "ignored", scale, "skip")
        assert ignored["offset_m"].iloc[0] == pytest.approx(5.0 * scale, abs=0.1)


def test_far_edges_are_lowered_by_the_drop_of_the_horizon():
    bed = RoadBed(seed=1, images=6)
    edges = RoadEdges.from_points(bed.road_edges)
    place = places_of(frames_of(bed), edges)[2]
    there = near_edges(place, edges, Reach())
    low = lowered(there, place)
    away = np.hypot(*(there.xyz_m[:, :2] - [place.start.x_m, place.start.y_m]).T)
    np.testing.assert_array_equal(low.xyz_m[:, :2], there.xyz_m[:, :2])
    drop = there.xyz_m[:, 2] - low.xyz_m[:, 2]
    np.testing.assert_allclose(drop, 0.87 * away**2 / (2 * 6_371_000.0), atol=1e-12)
    assert drop.max() > 1e-4
    assert low.left == there.left


@pytest.fixture(scope="module")
def level():
    return build_rural(2, 60.0, detail=0.01, scene=RuralScene(relief=0.0))


class TestScenes:
    def test_a_level_scene_has_a_level_road_where_the_hilly_one_is(self, level):
        hilly = build_rural(2, 60.0, detail=0.01)
        station = np.linspace(0, 60, 61)
        assert np.ptp(level.line.height(station)) == 0.0
        assert np.ptp(hilly.line.height(station)) > 0.1
        np.testing.assert_array_equal(level.line.plan(station, 2.0), hilly.line.plan(station, 2.0))

    def test_drives_with_another_field_of_view_or_no_side_views(self):
        usual, wide = random_drives(2)[0], random_drives(2, hfov_deg=80.0)[0]
        assert wide.intrinsics.hfov_deg == pytest.approx(80.0)
        assert wide.mount == usual.mount
        assert wide.views["right"] == pytest.approx(78.5)
        assert random_drives(2, side_views=False)[0].views == {"front": 0.0}
        assert random_drives(2)[1] == random_drives(2, hfov_deg=80.0)[1]

    def test_a_lens_moves_what_the_pinhole_shows(self, level):
        own = Intrinsics.from_field_of_view(160, 120, 60.0)
        lens = RadialLens.centred(-0.15, 0.0, 160, 120, own.focal_px)
        eye = np.array([*level.line.plan(10.0, -1.6), level.line.height(10.0) + 2.2])
        heading = 90.0 - np.degrees(level.line.heading(10.0))
        camera = Camera(own, cam_from_world(heading, 0.0, 0.0), eye)
        renderer = RuralRenderer(level)
        finish = Finish(noise=0.0)
        look = drive_look(2, 0)
        plain = renderer.render_view(camera, look, finish, 1)
        bent = renderer.render_view(camera, look, finish, 1, lens)
        # What a pixel of the lens shows lies on the ray through the straightened pixel.
        rows = [(100, 10), (110, 80), (95, 150)]
        for v, u in rows:
            straight = lens.undistort([[u, v]])[0]
            ray = (straight - [own.cx_px, own.cy_px]) / own.focal_px
            place = camera.position_m + bent.depth_m[v, u] * np.array([*ray, 1.0]) @ camera.rotation
            uv, _ = project(own, camera.rotation, eye, place[None])
            np.testing.assert_allclose(lens.distort(uv)[0], [u, v], atol=1e-3)
            assert level.height(place[None, :2])[0] == pytest.approx(place[2], abs=0.1)
        assert (plain.classes != bent.classes).mean() > 0.005
