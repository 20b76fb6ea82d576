import json

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json
from roadsight.stages.scene.ingest_cloud import ingest, main
from tests.helpers.las_files import DATA, needs_data, patched, random_points, wkt_of, write_las

US_FOOT = 1200 / 3937
UTM = wkt_of("EPSG:25832")
NOTHING_DROPPED = dict.fromkeys(
    ("withheld", "noise", "synthetic", "overlap", "repeated", "outside", "thinned"), 0
)


def run(tmp_path, clouds, crs="auto", units="auto", vertical="auto", target=None, **options):
    out = tmp_path / "out"
    choice = UnitChoice(crs, units, vertical)
    ingest(clouds, choice, target, 25, out / "cloud.parquet", out / "frame.json", **options)
    return CloudTiles(out / "cloud.parquet"), read_json(out / "frame.json")


def sorted_rows(xyz):
    return xyz[np.lexsort(np.asarray(xyz).T)]


def test_points_come_back_in_native_coordinates(tmp_path):
    xyz = random_points(4000)
    tiles, about = run(tmp_path, [write_las(tmp_path / "a.laz", xyz, UTM)])
    frame = Frame.from_dict(about)
    assert frame.origin == pytest.approx(xyz.min(axis=0), abs=1e-9)
    back = frame.to_native(stack_xyz(tiles.read()))
    np.testing.assert_allclose(sorted_rows(back), sorted_rows(xyz), rtol=0, atol=1e-5)
    assert about["points"] == 4000
    assert about["bounds_m"][:3] == [0, 0, 0]
    np.testing.assert_allclose(about["bounds_m"][3:], np.ptp(xyz, axis=0), atol=1e-5)
    assert (about["crs_name"], about["crs_source"]) == ("ETRS89 / UTM zone 32N", "header")
    assert about["dropped"] == NOTHING_DROPPED
    assert about["tile_size_m"] == 25


@pytest.mark.parametrize("chunk_points", [97, 1000, 10**6])
def test_bytes_do_not_depend_on_chunks(tmp_path, chunk_points):
    xyz = random_points(3000)
    clouds = [write_las(tmp_path / f"{i}.laz", xyz[i::2], UTM, intensity=i) for i in (0, 1)]
    run(tmp_path, clouds)
    expected = (tmp_path / "out" / "cloud.parquet").read_bytes()
    tiles, _ = run(tmp_path, clouds, chunk_points=chunk_points)
    assert (tmp_path / "out" / "cloud.parquet").read_bytes() == expected
    for number in range(len(tiles.tiles)):  # the first file's points come first in every tile
        intensity = tiles.read(["intensity"], [number])["intensity"]
        assert (np.diff(intensity.astype(int)) >= 0).all()


@pytest.mark.parametrize(
    ("crs", "unit", "vertical", "xy_m", "z_m"),
    [
        ("EPSG:25832", "auto", "auto", 1.0, 1.0),
        ("EPSG:6543+6360", "auto", "auto", US_FOOT, US_FOOT),
        ("EPSG:6543+5703", "auto", "auto", US_FOOT, 1.0),
        ("EPSG:32119", "auto", "us-survey-foot", 1.0, US_FOOT),
        ("local", "foot", "auto", 0.3048, 0.3048),
        ("local", "metre", "foot", 1.0, 0.3048),
    ],
)
def test_lengths_are_metres_whatever_the_units(tmp_path, crs, unit, vertical, xy_m, z_m):
    """The same 120 m x 80 m x 12 m box, stored in different units."""
    corner = np.array({"EPSG:25832": (458000, 5428000, 100)}.get(crs, (638750, 221750, 100)))
    box_m = random_points(1000, corner=(0, 0, 0))
    native = (box_m + corner) / (xy_m, xy_m, z_m)
    path = write_las(tmp_path / "a.laz", native, scale=0.0001)
    tiles, about = run(tmp_path, [path], crs, unit, vertical)
    assert (about["unit_m"], about["vertical_unit_m"]) == pytest.approx((xy_m, z_m), rel=1e-12)
    local = stack_xyz(tiles.read())
    expected = box_m - box_m.min(axis=0)
    np.testing.assert_allclose(local.max(axis=0), expected.max(axis=0), atol=1e-3)
    np.testing.assert_allclose(sorted_rows(local), sorted_rows(expected), atol=1e-3)


def test_noise_and_withheld_points_are_counted_and_do_not_move_the_origin(tmp_path):
    xyz = random_points(100)
    xyz[:3] -= 500.0
    classes = np.full(100, 2)
    classes[:2] = 7, 18
    withheld = np.arange(100) == 2
    path = write_las(tmp_path / "a.laz", xyz, UTM, classification=classes, withheld=withheld)
    tiles, about = run(tmp_path, [path])
    assert about["dropped"] == NOTHING_DROPPED | {"noise": 2, "withheld": 1}
    assert tiles.points == 97
    assert about["origin"] == pytest.approx(xyz[3:].min(axis=0), abs=1e-9)


def test_exact_duplicates_count_once(tmp_path):
    xyz = np.repeat(random_points(10), 3, axis=0)
    assert run(tmp_path, [write_las(tmp_path / "a.laz", xyz, UTM)])[0].points == 10


def test_one_point(tmp_path):
    tiles, about = run(tmp_path, [write_las(tmp_path / "a.laz", random_points(1), UTM)])
    assert tiles.points == 1
    assert about["bounds_m"] == [0] * 6


def test_wrong_header_bounds_do_not_matter(tmp_path):
    xyz = random_points(50)
    path = write_las(tmp_path / "a.las", xyz, UTM)
    bounds = (1e9, -1e9, np.nan, 0, 0, np.inf)
    patched(path, *((179 + 8 * n, "<d", value) for n, value in enumerate(bounds)))
    _, about = run(tmp_path, [path])
    assert about["origin"] == pytest.approx(xyz.min(axis=0), abs=1e-9)


def test_clouds_are_read_once_where_headers_are_right_and_the_bytes_are_the_same(tmp_path, caplog):
    """Too narrow, too wide or late colours: read again, to the same tiles."""
    caplog.set_level("INFO")
    xyz = random_points(500)
    colours = {name: np.where(np.arange(500) < 400, 200, 60_000) for name in ("red", "green")}
    path = write_las(tmp_path / "a.las", xyz, UTM, 7, blue=1, **colours)
    truth = path.read_bytes()
    run(tmp_path, [path])
    expected = (tmp_path / "out" / "cloud.parquet").read_bytes()
    assert "reading again" not in caplog.text
    for shift in (3.0, -3.0):
        path.write_bytes(truth)
        least = zip((187, 203, 219), xyz.min(axis=0), strict=True)
        patched(path, *((at, "<d", corner + shift) for at, corner in least))
        caplog.clear()
        run(tmp_path, [path], chunk_points=100)
        assert "reading again" in caplog.text
        assert (tmp_path / "out" / "cloud.parquet").read_bytes() == expected
    path.write_bytes(truth)
    caplog.clear()
    run(tmp_path, [path], chunk_points=100)
    assert "reading again" in caplog.text
    assert (tmp_path / "out" / "cloud.parquet").read_bytes() == expected


def test_colours_are_cut_to_8_bits_file_by_file(tmp_path):
    xyz = random_points(6)
    high = {name: np.arange(6) * 13000 for name in ("red", "green", "blue")}
    low = {name: np.arange(6) * 51 for name in ("red", "green", "blue")}
    deep = write_las(tmp_path / "deep.laz", xyz, UTM, 7, **high)
    flat = write_las(tmp_path / "flat.laz", xyz, UTM, 7, **low)
    tiles, _ = run(tmp_path, [deep])
    assert sorted(tiles.read()["red"]) == [0, 50, 101, 152, 203, 253]
    assert sorted(run(tmp_path, [flat])[0].read()["red"]) == [0, 51, 102, 153, 204, 255]
    grey = write_las(tmp_path / "grey.laz", xyz, UTM)
    black = write_las(tmp_path / "black.laz", xyz, UTM, 7)
    for without in (grey, black):
        assert "red" not in run(tmp_path, [deep, without])[0].columns


def test_reprojection_on_the_way_in(tmp_path):
    from pyproj import Transformer

    lon_lat = random_points(200, extent=(0.001, 0.001, 10), corner=(9.0, 50.0, 100.0))
    path = write_las(tmp_path / "a.laz", lon_lat, wkt_of("EPSG:4979"), scale=1e-8)
    with pytest.raises(InputError, match=r"degrees.*target_crs: EPSG:32632"):
        run(tmp_path, [path])
    assert not (tmp_path / "out").exists()
    tiles, about = run(tmp_path, [path], target="EPSG:32632")
    x, y = Transformer.from_crs(4326, 32632, always_xy=True).transform(*lon_lat[:, :2].T)
    expected = np.stack([x - x.min(), y - y.min(), lon_lat[:, 2] - lon_lat[:, 2].min()], axis=1)
    expected = expected[np.unique(lon_lat, axis=0, return_index=True)[1]]
    np.testing.assert_allclose(
        sorted_rows(stack_xyz(tiles.read())), sorted_rows(expected), atol=3e-3
    )
    assert about["crs_name"] == "WGS 84 / UTM zone 32N"


def test_degrees_declared_as_metres(tmp_path):
    xyz = random_points(100, extent=(0.003, 0.002, 15), corner=(4.36, 52.01, 0))
    path = write_las(tmp_path / "a.laz", xyz, scale=1e-7)
    for crs in ("local", "EPSG:28992"):
        with pytest.raises(InputError, match="look like longitude and latitude"):
            run(tmp_path, [path], crs)


def test_files_that_contradict_each_other_are_named(tmp_path):
    one = write_las(tmp_path / "one.laz", random_points(10), UTM)
    two = write_las(tmp_path / "two.laz", random_points(10), wkt_of("EPSG:28992"))
    with pytest.raises(InputError, match=r"one\.laz and .*two\.laz.*differ in CRS"):
        run(tmp_path, [one, two])
    with pytest.raises(InputError, match="listed twice"):
        run(tmp_path, [one, one])


def test_stray_point_far_away(tmp_path):
    xyz = random_points(10)
    xyz[0, 0] += 150_000
    with pytest.raises(InputError, match="too large for one site"):
        run(tmp_path, [write_las(tmp_path / "a.laz", xyz, UTM)])


@pytest.mark.filterwarnings("error")
def test_stray_point_that_the_header_hides(tmp_path):
    xyz = [[500_000, 5_500_000, 0], [500_000, 5_500_000, 0], [550_000, 5_500_000, 0]]
    path = write_las(tmp_path / "a.las", xyz, UTM, scale=1e3)
    content = bytearray(path.read_bytes())
    start = int.from_bytes(content[96:100], "little")  # offset to point data
    content[start : start + 4] = (2_000_000_000).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match="too large for one site"):
        ingest([path], UnitChoice(), None, 1, tmp_path / "c.parquet", tmp_path / "f.json")


@pytest.mark.parametrize("size", [0.5, 0.0, -5.0, 12.5, float("nan"), float("inf")])
def test_tiles_of_broken_metres_are_refused(tmp_path, size):
    path = write_las(tmp_path / "a.laz", random_points(10), UTM)
    with pytest.raises(InputError, match="whole metres"):
        ingest([path], UnitChoice(), None, size, tmp_path / "c.parquet", tmp_path / "f.json")


def test_command_line(tmp_path, capsys):
    path = write_las(tmp_path / "a.laz", random_points(10), UTM)
    cloud, frame = tmp_path / "c.parquet", tmp_path / "f.json"
    common = ["--site", "s", "--cloud", str(cloud), "--frame", str(frame)]
    assert main([*common, "--target-crs", "", "--tile-size-m", "50.0", "--clouds", str(path)]) == 0
    before = cloud.read_bytes()
    assert json.loads(frame.read_text())["inputs"].keys() == {str(path)}
    assert main([*common, "--clouds", str(tmp_path / "missing.laz")]) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1
    assert "site s" in message[0]
    assert "no such file" in message[0]
    assert cloud.read_bytes() == before


# --- real data ---


def real(tmp_path, name, *choice, target=None):
    return run(tmp_path, [DATA / "clouds" / name], *choice, target=target)


@needs_data
@pytest.mark.parametrize(
    ("name", "crs", "points", "size_m", "place"),
    [
        ("delft/cloud.laz", "EPSG:28992", 640510, (191.7, 228.5), (4.366, 52.011)),
        ("amsterdam_poles/cloud.laz", "EPSG:28992", 43536, (52.0, 52.0), (4.87, 52.353)),
        ("autzen_arterial.laz", "auto", 984137, (365.8, 298.7), (-123.0727, 44.0609)),
        ("montpellier_street.laz", "auto", 417106, (150.0, 100.0), (3.87, 43.60)),
    ],
)
def test_real_clouds(tmp_path, name, crs, points, size_m, place):
    tiles, about = real(tmp_path, name, crs)
    assert tiles.points == points
    assert about["bounds_m"][3:5] == pytest.approx(size_m, abs=0.1)
    location = about["location"]
    assert (location["lon_deg"], location["lat_deg"]) == pytest.approx(place, abs=0.02)


@needs_data
def test_real_unit_trap(tmp_path):
    name = "nc_unit_trap.laz"
    with pytest.raises(InputError, match="states no CRS"):
        real(tmp_path, name)
    with pytest.raises(InputError, match=r"cannot be.*EPSG:32119.*vertical_units"):
        real(tmp_path, name, "EPSG:2264")
    with pytest.raises(InputError, match="vertical_units"):
        real(tmp_path, name, "EPSG:32119")
    _, about = real(tmp_path, name, "EPSG:32119", "auto", "us-survey-foot")
    assert about["location"]["lat_deg"] == pytest.approx(35.749, abs=1e-3)
    assert about["bounds_m"][5] == pytest.approx(284.44 * US_FOOT, abs=0.05)


@needs_data
def test_real_cloud_in_feet_reprojected_to_metres(tmp_path):
    _, feet = real(tmp_path, "autzen_trim.laz")
    tiles, metres = real(tmp_path, "autzen_trim.laz", target="EPSG:32610")
    assert metres["vertical_unit"] == "foot"
    assert metres["bounds_m"][5] == pytest.approx(feet["bounds_m"][5], abs=1e-3)
    diagonals = [np.hypot(*about["bounds_m"][3:5]) for about in (feet, metres)]
    assert diagonals[0] == pytest.approx(diagonals[1], rel=0.05)
    assert tiles.points == 110000


@pytest.mark.parametrize("timed", [True, False])
def test_a_share_of_the_pulses_is_what_a_sparser_survey_gives(tmp_path, timed):
    """Pulses that files tell apart stay whole, wherever the file or the chunk ends."""
    xyz = random_points(8000)
    pulse = np.repeat(np.arange(4000), 2)
    dims = {"gps_time": 1000.0 + pulse} if timed else {}
    parts = [slice(0, 5000), slice(5000, 8000)]
    clouds = [
        write_las(
            tmp_path / f"{number}.laz", xyz[part], UTM, intensity=pulse[part],
            **{name: values[part] for name, values in dims.items()},
        )
        for number, part in enumerate(parts)
    ]  # fmt: skip
    tiles, about = run(tmp_path, clouds, pulse_share=0.25, chunk_points=333)
    kept = tiles.read(["intensity"])["intensity"]
    assert len(kept) == pytest.approx(2000, abs=160)
    assert about["points"] + about["dropped"]["thinned"] == 8000
    _, count = np.unique(kept, return_counts=True)
    assert set(count) == ({2} if timed else {1, 2})
    again, _ = run(tmp_path, clouds, pulse_share=0.25)
    np.testing.assert_array_equal(again.read(["intensity"])["intensity"], kept)


def test_a_share_without_a_point_is_refused(tmp_path):
    cloud = write_las(tmp_path / "a.laz", random_points(100), UTM)
    with pytest.raises(InputError, match=r"scene\.pulse_share"):
        run(tmp_path, [cloud], pulse_share=1e-9)
