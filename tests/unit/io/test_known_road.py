import geopandas as gpd
import numpy as np
import pytest
from shapely import LineString

from roadsight.base.errors import InputError
from roadsight.io.vector.known import read_seeds, read_track
from tests.unit.placement.stages.test_solve_cover_stage import FRAME


def test_seeds_are_read_in_the_cloud_s_coordinates():
    local = np.array([[1.5, -2.0], [30.0, 4.0]])
    native = FRAME.to_native(np.column_stack([local, np.zeros(2)]))
    text = ";".join(f"{x!r},{y!r}" for x, y in native[:, :2].tolist())
    np.testing.assert_allclose(read_seeds(text, FRAME, "here"), local, atol=1e-6)
    np.testing.assert_allclose(read_seeds(f" {text}; ", FRAME, "here"), local, atol=1e-6)
    assert read_seeds("", FRAME, "here") is None
    assert read_seeds(None, FRAME, "here") is None


@pytest.mark.parametrize("wrong", ["nan,1", "1,-inf", "1", "1,2,3", "a,b"])
def test_the_seed_that_is_no_place_is_named(wrong):
    with pytest.raises(InputError, match=r"^pavement\.seeds: seed 3 of 4 is no place") as told:
        read_seeds(f"1,2;3,4;{wrong};5,6", FRAME, "pavement.seeds")
    assert wrong in str(told.value)


def test_the_longest_line_of_a_file_is_the_track(tmp_path):
    local = [np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 1.0], [50.0, 1.0]])]
    lines = [LineString(FRAME.to_native(np.c_[xy, np.zeros(2)])[:, :2]) for xy in local]
    gpd.GeoDataFrame(geometry=lines, crs=FRAME.crs_wkt).to_file(tmp_path / "drive.gpkg")
    found = read_track(tmp_path / "drive.gpkg", FRAME)
    np.testing.assert_allclose(found[:, :2], local[1], atol=1e-6)
    assert read_track(None, FRAME) is None
