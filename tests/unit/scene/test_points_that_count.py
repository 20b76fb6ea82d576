import shutil

import laspy
import numpy as np
import pytest

from roadsight.api.clouds import labels_of
from roadsight.api.scene import ground
from roadsight.base.errors import InputError
from roadsight.commands.verb import Reading, load_cloud
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.tiles import CloudTiles
from roadsight.io.records.atomic import read_json
from roadsight.stages.scene.ingest_cloud import ingest
from tests.helpers.las_files import random_points, wkt_of, write_las

UTM = wkt_of("EPSG:25832")
XYZ = random_points(4000, extent=(60.0, 30.0, 0.02))


def ingested(folder, *clouds, **options):
    ingest(
        list(clouds), UnitChoice(), None, 50.0, folder / "cloud.parquet", folder / "frame.json",
        **options,
    )  # fmt: skip
    return CloudTiles(folder / "cloud.parquet"), read_json(folder / "frame.json")


def tile(path, rows, **dims):
    number = np.arange(4000)
    return write_las(
        path, XYZ[rows], UTM, gps_time=number[rows] / 7, return_number=1, intensity=5, **dims
    )


def test_equal_points_of_tiles_count_once(tmp_path):
    one, two = XYZ[:, 0] < 458035, XYZ[:, 0] > 458025
    a = tile(tmp_path / "a.laz", one)
    b = tile(tmp_path / "b.las", two)
    cloud, about = ingested(tmp_path, a, b)
    assert cloud.points == 4000
    assert about["dropped"]["repeated"] == (one & two).sum()


def test_points_that_differ_in_time_count_each(tmp_path):
    number = np.arange(4000)
    write_las(tmp_path / "a.laz", np.repeat(XYZ[:2000], 2, axis=0), UTM, gps_time=number + 1.0)
    assert ingested(tmp_path, tmp_path / "a.laz")[0].points == 4000


def test_a_copy_under_another_name_is_refused(tmp_path):
    a = tile(tmp_path / "a.laz", slice(None))
    shutil.copy(a, tmp_path / "b.laz")
    with pytest.raises(InputError, match="same file"):
        ingested(tmp_path, a, tmp_path / "b.laz")


def test_the_same_points_in_another_file_count_once(tmp_path):
    a, b = (tile(tmp_path / name, slice(None)) for name in ("a.laz", "b.las"))
    assert ingested(tmp_path, a, b)[0].points == 4000


@pytest.mark.parametrize("flag", ["withheld", "synthetic", "overlap"])
@pytest.mark.parametrize("choice", ["use", "leave_out"])
def test_flags_in_the_workflow_and_in_verbs(tmp_path, flag, choice):
    flagged = np.arange(4000) < 300
    path = tile(tmp_path / "a.laz", slice(None), **{flag: flagged})
    left = 300 if flag != "overlap" or choice == "leave_out" else 0
    assert ingested(tmp_path, path, overlap=choice)[0].points == 4000 - left
    assert len(loaded(path, choice).xyz_m) == 4000 - left


def test_class_12_is_overlap_in_old_formats(tmp_path):
    path = write_las(
        tmp_path / "a.las", XYZ, UTM, 1, "1.2", classification=12 * (np.arange(4000) < 9)
    )
    assert len(loaded(path, "leave_out").xyz_m) == 3991
    assert len(loaded(path, "use").xyz_m) == 4000


def loaded(path, overlap="use"):
    return load_cloud(path, Reading(UnitChoice(vertical_units="metre"), overlap))


@pytest.mark.parametrize("mark", [{"classification": 7}, {"classification": 18}, {"withheld": 1}])
def test_verbs_leave_noise_as_it_is(tmp_path, mark):
    noise = XYZ[:400] - [0, 0, 3.0]
    clean = loaded(tile(tmp_path / "clean.laz", slice(None)))
    path = write_las(tmp_path / "noisy.laz", np.vstack([XYZ, noise]), UTM, gps_time=np.arange(4400))
    las = laspy.read(path)
    for name, value in mark.items():
        las[name][4000:] = value
    las.write(str(path))
    noisy = loaded(path)
    assert ground(noisy).sum() == ground(clean).sum()
    labels = labels_of(noisy, ground(noisy), None)
    assert set(labels[4000:]) == {mark.get("classification", 0)}


def test_a_point_that_is_there_twice_is_labelled_twice(tmp_path):
    path = write_las(tmp_path / "a.laz", np.vstack([XYZ, XYZ[:500]]), UTM)
    cloud = loaded(path)
    assert len(cloud.xyz_m) == 4000
    labels = labels_of(cloud, ground(cloud), None)
    np.testing.assert_array_equal(labels[4000:], labels[:500])


@pytest.mark.parametrize("kind", ["class7", "withheld"])
def test_ground_of_flagged_cases(cases, kind):
    folder = cases / "06-flagged-noise-is-used-by-verbs"
    right, found = loaded(folder / "right.laz"), loaded(folder / f"{kind}.laz")
    assert ground(found).sum() == ground(right).sum()


def test_buffered_tiles_of_the_cases(cases, tmp_path):
    folder = cases / "26-buffered-tiles"
    right = ingested(tmp_path, folder / "right.laz")[0]
    both = ingested(tmp_path, folder / "t1.laz", folder / "t2.laz")[0]
    assert both.points == right.points
