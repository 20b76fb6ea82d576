import shutil
import struct

import laspy
import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.cloud_scan import Contents, kept_chunks, scan_cloud
from roadsight.io.cloud.clouds import are_apart, iter_chunks, read_header, read_laz, write_laz
from tests.helpers.las_files import (
    DATA,
    in_chunks,
    needs_data,
    patched,
    random_points,
    wkt_of,
    write_las,
)

XYZ = random_points(500)


def test_header_and_points_are_exact(tmp_path):
    path = write_las(tmp_path / "a.laz", XYZ, wkt_of("EPSG:25832"))
    header = read_header(path)
    assert header.points == 500
    assert header.stated.crs.to_epsg() == 25832
    assert not header.coloured
    np.testing.assert_allclose(read_laz(path).xyz, XYZ, rtol=0, atol=1e-6)


@pytest.mark.parametrize("suffix", ["las", "laz", "LAS", "LAZ"])
@pytest.mark.parametrize(
    ("point_format", "version"), [(0, "1.2"), (3, "1.2"), (6, "1.4"), (7, "1.4")]
)
def test_formats_and_chunks_give_the_same_points(tmp_path, suffix, point_format, version):
    number = np.arange(500)
    dims = {"intensity": number, "classification": number % 19, "return_number": number % 4}
    if point_format in (3, 7):
        dims |= {"red": number, "green": number + 1, "blue": number + 2}
    path = write_las(tmp_path / f"a.{suffix}", XYZ, None, point_format, version, **dims)
    whole = next(iter_chunks(path))
    parts = list(iter_chunks(path, 77))
    assert [len(part) for part in parts] == [77] * 6 + [38]
    for name in ("xyz", "intensity", "classification", "return_number", "withheld"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    np.testing.assert_array_equal(whole.intensity, number)
    np.testing.assert_array_equal(whole.classification, number % 19)
    assert (whole.colour is not None) == (point_format in (3, 7))
    if whole.colour is not None:
        np.testing.assert_array_equal(whole.colour[:, 2], number + 2)


@pytest.mark.parametrize("chunk_points", [7, 77, 200, 230, 500, 10**6])
def test_chunks_are_cut_from_what_is_decoded_at_once(tmp_path, monkeypatch, chunk_points):
    monkeypatch.setattr("roadsight.io.cloud.clouds._DECODED_POINTS", 200)
    path = write_las(tmp_path / "a.laz", XYZ)
    chunks = list(iter_chunks(path, chunk_points))
    full, rest = divmod(500, chunk_points)
    assert [len(chunk) for chunk in chunks] == [chunk_points] * full + [rest] * (rest > 0)
    np.testing.assert_array_equal(np.concatenate([c.xyz for c in chunks]), read_laz(path).xyz)


def spread(path):
    """Whether threads decode the chunks of a file."""
    with laspy.open(path) as reader:
        return are_apart(path, reader.header)


CHUNKS = [64, [100, 1, 300, 99], 500, [500]]
FORMATS = [(0, "1.2"), (3, "1.2"), (6, "1.4"), (7, "1.4")]


@pytest.mark.parametrize("sizes", CHUNKS, ids=str)
@pytest.mark.parametrize(("point_format", "version"), FORMATS)
def test_chunks_decoded_by_threads_give_the_same_points(tmp_path, point_format, version, sizes):
    dims = {"intensity": np.arange(500), "classification": np.arange(500) % 19}
    path = write_las(tmp_path / "a.laz", XYZ, None, point_format, version, **dims)
    assert not spread(path)  # one chunk of 50,000
    before = read_laz(path)
    in_chunks(path, sizes)
    assert spread(path) == (sizes in (CHUNKS[0], CHUNKS[1]))
    after = read_laz(path)
    np.testing.assert_array_equal(after.xyz, before.xyz)
    for name, values in before.dims.items():
        np.testing.assert_array_equal(after.dims[name], values)
    parts = list(iter_chunks(path, 77))
    np.testing.assert_array_equal(np.concatenate([part.xyz for part in parts]), before.xyz)


@pytest.mark.parametrize(("point_format", "version"), FORMATS)
def test_a_chunk_table_that_does_not_fit_the_points_is_not_relied_on(
    tmp_path, point_format, version
):
    path = write_las(tmp_path / "a.laz", XYZ, None, point_format, version)
    in_chunks(path, 200)
    with laspy.open(path) as reader:
        points_at = reader.header.offset_to_point_data
    (table_at,) = struct.unpack_from("<q", path.read_bytes(), points_at)
    whole = path.read_bytes()
    for count, sizes in [(3, b""), (3, bytes(12)), (3, b"\xff" * 40), (0, bytes(40))]:
        path.write_bytes(whole[: table_at + 4] + struct.pack("<I", count) + sizes)
        assert not spread(path)
    np.testing.assert_allclose(next(iter_chunks(path)).xyz, XYZ, rtol=0, atol=1e-6)


def test_more_chunks_than_their_first_points_have_room_for_are_refused(tmp_path):
    path = write_las(tmp_path / "a.laz", XYZ)
    with laspy.open(path) as reader:
        points_at = reader.header.offset_to_point_data
    (table_at,) = struct.unpack_from("<q", path.read_bytes(), points_at)
    patched(path, (table_at + 4, "<I", path.stat().st_size // 20 + 2))
    with pytest.raises(InputError, match="chunk table announces"):
        read_header(path)


def test_chunks_beyond_memory_are_decoded_one_after_the_other(tmp_path):
    path = in_chunks(write_las(tmp_path / "a.laz", XYZ), 100)
    data = path.read_bytes()
    with laspy.open(path) as reader:
        record = reader.header.vlrs.get("LasZipVlr")[0].record_data
    huge = record[:12] + struct.pack("<I", 2**31) + record[16:]
    path.write_bytes(data.replace(record, huge))
    assert not spread(path)


def test_scan_leaves_noise_and_withheld_out(tmp_path):
    classes = np.array([2, 7, 18, 2, 7, 6, 1, 2])
    withheld = np.array([0, 0, 0, 1, 1, 0, 0, 0])
    xyz = np.arange(24.0).reshape(8, 3) * 3
    path = write_las(tmp_path / "a.laz", xyz, classification=classes, withheld=withheld)
    contents = Contents()
    scan = scan_cloud(path, None, 3, contents.take)
    assert (scan.points, scan.withheld, scan.noise) == (4, 2, 2)
    assert contents.classes == {1: 1, 2: 2, 6: 1}
    np.testing.assert_allclose(scan.lower, xyz[0])
    np.testing.assert_allclose(scan.upper, xyz[7])
    kept = np.concatenate([chunk.xyz for chunk, *_ in kept_chunks(path, None, 3)])
    np.testing.assert_allclose(kept, xyz[[0, 5, 6, 7]])
    assert not contents.intense
    assert len(scan.sha256) == 64


def test_nothing_but_noise_is_an_error(tmp_path):
    path = write_las(tmp_path / "a.las", XYZ[:5], classification=[7] * 5)
    with pytest.raises(InputError, match="no points but noise"):
        scan_cloud(path)


def test_points_that_cannot_be_reprojected_are_an_error(tmp_path):
    path = write_las(tmp_path / "a.las", XYZ[:5])
    with pytest.raises(InputError, match="cannot be reprojected"):
        scan_cloud(path, lambda xyz: xyz * np.inf)


def test_geotiff_keys_are_read(tmp_path):
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales = np.full(3, 0.001)
    keys = [(1, 1, 0, 2), (3072, 0, 1, 2264), (4099, 0, 1, 9003)]
    data = struct.pack("<12H", *np.ravel(keys))
    header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", data))
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.zeros((3, 2))
    las.write(str(tmp_path / "a.las"))
    stated = read_header(tmp_path / "a.las").stated
    assert stated.crs.to_epsg() == 2264
    assert stated.vertical_unit_m == pytest.approx(1200 / 3937)


# --- writing ---


@pytest.mark.parametrize("code", ["EPSG:25832", "EPSG:2264", "EPSG:6543+6360", None])
def test_written_cloud_reads_back_to_half_a_step(tmp_path, code):
    scale = 1200 / 3937 if code and code != "EPSG:25832" else 1.0
    frame = Frame((458000.4, 5428000.6, 100.2), scale, scale, code and wkt_of(code))
    xyz_m = random_points(300, 1, corner=(0, 0, 0))
    dims = {
        "intensity": np.arange(300, dtype=np.uint16), "classification": np.arange(300) % 30,
        "withheld": np.arange(300) % 2 == 0, "scan_angle_rank": np.full(300, -15, np.int8),
        "label": np.arange(300, dtype=np.uint32), "score": np.linspace(0, 1, 300, dtype=np.float32),
    }  # fmt: skip
    path = tmp_path / "out" / "a.laz"
    write_laz(path, xyz_m, frame, dims)
    back = read_laz(path)
    half_step_m = 0.0005 * scale * 1.001
    np.testing.assert_allclose(frame.to_local(back.xyz), xyz_m, rtol=0, atol=half_step_m)
    for name in ("intensity", "classification", "label", "score", "withheld"):
        np.testing.assert_array_equal(back.dims[name], dims[name])
    assert back.dims["label"].dtype == np.uint32
    assert set(back.dims["scan_angle"]) == {-2500}
    stated = back.header.stated.crs
    assert (stated is None) if code is None else stated.is_compound == ("+" in code)
    assert [p.name for p in path.parent.iterdir()] == ["a.laz"]


def test_same_points_same_bytes(tmp_path, monkeypatch):
    frame = Frame((0.0, 0.0, 0.0))
    write_laz(tmp_path / "a.laz", XYZ - XYZ.min(axis=0), frame, {"red": [1] * 500})
    write_laz(tmp_path / "b.laz", XYZ - XYZ.min(axis=0), frame, {"red": [1] * 500})
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()


def test_colours_and_no_points(tmp_path):
    colours = {name: np.arange(3, dtype=np.uint16) for name in ("red", "green", "blue")}
    write_laz(tmp_path / "a.laz", np.zeros((3, 3)), Frame((0.0, 0.0, 0.0)), colours)
    assert read_header(tmp_path / "a.laz").coloured
    write_laz(tmp_path / "b.laz", np.zeros((0, 3)), Frame((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="holds no points"):
        read_header(tmp_path / "b.laz")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e7])
def test_coordinates_that_las_cannot_hold_leave_no_file(tmp_path, bad):
    with pytest.raises(InputError, match="too far"):
        write_laz(tmp_path / "a.laz", [[0, 0, 0], [0, bad, 0]], Frame((0.0, 0.0, 0.0)))
    assert list(tmp_path.iterdir()) == []


# --- bad input ---


def test_missing_directory_and_wrong_name(tmp_path):
    (tmp_path / "folder.laz").mkdir()
    (tmp_path / "a.txt").write_text("x y z")
    (tmp_path / "empty.laz").touch()
    for name, message in [
        ("no.laz", "no such file"),
        ("folder.laz", "is a directory"),
        ("a.txt", "no point cloud by its name"),
        ("empty.laz", "header is missing"),
    ]:
        with pytest.raises(InputError, match=message):
            read_header(tmp_path / name)


@pytest.mark.parametrize(
    ("at", "value"), [(139, 0.0), (139, np.nan), (139, np.inf), (139, -0.001), (171, np.nan)]
)
def test_unusable_scale_or_offset(tmp_path, at, value):
    path = patched(write_las(tmp_path / "a.las", XYZ), (at, "<d", value))
    with pytest.raises(InputError, match="unusable scale or offset"):
        read_header(path)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_more_points_announced_than_present(tmp_path, suffix):
    path = patched(write_las(tmp_path / f"a.{suffix}", XYZ), (247, "<Q", 501))
    with pytest.raises(InputError, match=r"a\.la[sz]"):
        list(iter_chunks(path))


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_every_truncation_is_one_message(tmp_path, suffix):
    path = write_las(tmp_path / f"a.{suffix}", XYZ, wkt_of("EPSG:25832"))
    data = path.read_bytes()
    for length in np.linspace(0, len(data) - 1, 60).astype(int):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            list(iter_chunks(path))


@pytest.mark.parametrize(
    ("suffix", "point_format", "sizes"),
    [("las", 1, None), ("laz", 1, None), ("laz", 7, None), ("laz", 1, 60), ("laz", 7, 60)],
)
def test_flipped_bytes_give_points_or_one_message(tmp_path, suffix, point_format, sizes):
    version = "1.4" if point_format > 5 else "1.2"
    path = write_las(tmp_path / f"a.{suffix}", XYZ, wkt_of("EPSG:25832"), point_format, version)
    if sizes:
        in_chunks(path, sizes)
    data = path.read_bytes()
    rng = np.random.default_rng(5)
    read = failed = 0
    for _ in range(150):
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), rng.integers(1, 8)):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read += sum(len(chunk) for chunk in iter_chunks(path)) > 0
        except InputError as error:
            failed += str(path) in str(error)
    assert read + failed == 150
    assert failed > 0


@needs_data
def test_real_headers():
    names = {
        "autzen_arterial.laz": "NAD_1983_HARN_Lambert_Conformal_Conic",
        "autzen_trim.laz": "NAD_1983_HARN_Lambert_Conformal_Conic",
        "montpellier_street.laz": "RGF93 v1 / Lambert-93",
    }
    for file, name in names.items():
        assert read_header(DATA / "clouds" / file).stated.crs.name == name
    for file in ("delft/cloud.laz", "junction_mls.laz", "nc_unit_trap.laz"):
        assert read_header(DATA / "clouds" / file).stated.crs is None


@needs_data
def test_real_cloud_truncated(tmp_path):
    path = tmp_path / "cut.laz"
    shutil.copy(DATA / "clouds" / "amsterdam_poles" / "cloud.laz", path)
    path.chmod(0o644)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cut off"):
        scan_cloud(path)
