import struct

import laspy
import numpy as np
import pytest
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.stated import stated_crs
from roadsight.io.cloud.clouds import read_header, read_laz, write_laz
from tests.helpers.las_files import patched, random_points, write_las

XYZ = random_points(60)
UTM_32, UTM_33 = (CRS.from_epsg(code).to_wkt("WKT1_GDAL") for code in (25832, 25833))
CENTRE = (500_000.0, 5_400_000.0)
TMERC = {1024: 1, 2048: 4258, 3072: 32767, 3074: 32767, 3075: 1, 3076: 9001} | {
    3080: 9.0, 3081: 0.0, 3082: 500_000.0, 3083: 0.0, 3092: 0.9996,
}  # fmt: skip


@pytest.mark.parametrize(
    ("wkt_bit", "only_wkt", "code"), [(True, True, 25833), (False, False, 25832), (False, True, 0)]
)
def test_the_wkt_bit_decides_and_both_are_named(wkt_bit, only_wkt, code):
    found = stated_crs(UTM_33, {3072: 25832}, wkt_bit=wkt_bit, only_wkt=only_wkt, centre=CENTRE)
    told = " ".join([found.problem, *found.notes])
    assert "zone 32N" in told
    assert "zone 33N" in told
    assert (0 if found.crs is None else found.crs.to_epsg()) == code


def test_records_that_agree_need_no_word():
    assert stated_crs(UTM_32, {3072: 32632}, centre=CENTRE).notes == ()


def test_the_wkt_2_record_is_read_and_yields_to_the_old_one():
    wkt_2 = CRS.from_epsg(25832).to_wkt()
    assert stated_crs(None, {}, wkt_2=wkt_2).crs.to_epsg() == 25832
    both = stated_crs(UTM_33, {}, wkt_2=wkt_2, centre=CENTRE)
    assert both.crs.to_epsg() == 25833
    assert "4224" in both.notes[0]
    assert stated_crs("rubbish", {}, wkt_2=wkt_2).crs.to_epsg() == 25832


def test_vertical_keys_stand_beside_a_horizontal_wkt():
    assert stated_crs(UTM_32, {4099: 9003}).vertical_unit_m == pytest.approx(1200 / 3937)
    both = stated_crs(CRS.from_user_input("EPSG:6543+6360").to_wkt(), {4099: 9001})
    assert both.vertical_unit_m == pytest.approx(1200 / 3937)
    assert "z in metre" in both.notes[0]


def test_a_unit_that_contradicts_its_code_is_named():
    assert "EPSG:26910 in metre" in stated_crs(None, {3072: 26910, 3076: 9002}).notes[0]
    assert "EPSG:5703 in metre" in stated_crs(None, {3072: 2264, 4096: 5703, 4099: 9003}).notes[0]


def test_a_projection_of_its_own_by_its_parameters():
    found = stated_crs(None, TMERC)
    assert found.crs.equals(CRS.from_epsg(25832), ignore_axis_order=True) or (
        found.crs.to_epsg(min_confidence=20) == 25832
    )
    assert stated_crs(None, TMERC | {3074: 16032, 3075: 0}).crs.is_projected


@pytest.mark.parametrize("key", [2048, 3080, 3082, 3075])
def test_a_projection_without_a_parameter_is_told_by_its_key(key):
    keys = {name: value for name, value in TMERC.items() if name != key}
    found = stated_crs(None, keys)
    assert found.crs is None
    assert str(key) in found.problem


@pytest.mark.parametrize(
    "wkt",
    [
        f'COMPD_CS["x",{UTM_32}]',
        f'COMPD_CS["x, [y",{UTM_32},VERT_CS["unknown"]]',
        f'COMPOUNDCRS["x",{CRS.from_epsg(25832).to_wkt()}]',
    ],
)
def test_a_compound_of_one_part_is_that_part(wkt):
    assert stated_crs(wkt, {}).crs.to_epsg() == 25832


def test_counts_that_stand_in_one_place(tmp_path):
    path = write_las(tmp_path / "a.las", XYZ, point_format=1, return_number=1)
    assert read_header(patched(path, (247, "<Q", 0), (107, "<I", 60))).points == 60
    assert "older versions" in read_header(path).notes[0]
    patched(path, (107, "<I", 0))
    assert read_header(path).points == 60  # by their returns
    patched(path, (255, "<Q", 0), (111, "<I", 0))
    with pytest.raises(InputError, match="room for 60"):
        read_header(path)
    patched(path, (247, "<Q", 40))
    assert "room for 60" in read_header(path).notes[0]


def test_a_newer_version_is_told_by_its_number(tmp_path):
    with pytest.raises(InputError, match=r"is LAS 1\.5"):
        read_header(patched(write_las(tmp_path / "a.las", XYZ), (25, "<B", 5)))


def test_what_the_writer_knew_is_carried(tmp_path):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.file_source_id, header.system_identifier = 77, "Scanner 9"
    header.add_extra_dim(laspy.ExtraBytesParams("normal", "3f4", "unit vector"))
    header.add_extra_dim(
        laspy.ExtraBytesParams("width", "u2", "m", offsets=np.array([1.0]), scales=np.array([0.01]))
    )
    header.vlrs.append(laspy.VLR("LASF_Spec", 3, "text", b"flown in May"))
    las = laspy.LasData(header)
    las.x, las.y, las.z = XYZ.T
    las["normal"], las["width"] = XYZ / 7, np.arange(60) / 10 + 1
    las.write(str(tmp_path / "a.laz"))
    cloud, frame = read_laz(tmp_path / "a.laz"), Frame((458000.0, 5428000.0, 100.0))
    write_laz(
        tmp_path / "b.laz", frame.to_local(cloud.xyz), frame, cloud.dims, cloud.header.carried
    )
    with laspy.open(tmp_path / "b.laz") as reader:
        back = reader.read()
    assert back.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert (back.header.file_source_id, back.header.system_identifier) == (77, "Scanner 9")
    assert b"flown in May" in [record.record_data_bytes() for record in back.header.vlrs]
    np.testing.assert_array_equal(back["normal"], las["normal"])
    np.testing.assert_allclose(back["width"], las["width"])
    described = {dim.name: dim.description for dim in back.point_format.extra_dimensions}
    assert described == {"normal": "unit vector", "width": "m"}


def test_bytes_that_nothing_describes_are_left_out(tmp_path):
    path = write_las(tmp_path / "a.las", XYZ)
    data, (start,) = path.read_bytes(), struct.unpack_from("<I", path.read_bytes(), 96)
    records = np.frombuffer(data[start:], "u1").reshape(60, 30)
    path.write_bytes(data[:start] + np.hstack([records, np.full((60, 20), 7, "u1")]).tobytes())
    cloud = read_laz(patched(path, (105, "<H", 50)))
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-6)
    assert cloud.header.left_out == ("ExtraBytes",)
    assert "ExtraBytes" not in cloud.dims


@pytest.mark.parametrize(
    ("file", "code"),
    [
        ("01-wkt-beside-geokeys/conflict.laz", 32632),
        ("03-vector-extra-dimension/normals.laz", 32632),
        ("04-undocumented-extra-bytes/helios_like.las", 32632),
        ("16-count-only-in-one-place/legacy_only.las", 32632),
        ("17-wkt2-record-of-las-15/wkt2_4224.laz", 32632),
        ("23-crs-in-words-only/compd_one.laz", 32632),
        ("23-crs-in-words-only/userdefined.laz", 25832),
    ],
)
def test_clouds_of_the_cases(cases, file, code):
    assert read_header(cases / file).stated.crs.to_epsg(min_confidence=20) == code
    assert len(read_laz(cases / file).xyz) > 3000
