import json

import laspy
import numpy as np
import pytest

from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.tables import read_table
from roadsight.stages.evidence import summarise_site
from roadsight.stages.scene import build_dem, ingest_cloud, profile_scene


def run(folder, xyz, classes, *options, scan=0, east_of=np.inf):
    """Doubts by their code, frame and exit status of a site of points, in one file or two."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
    clouds, east = [], xyz[:, 0] > east_of
    for name, own in (("cloud.laz", ~east), ("east.laz", east)):
        if own.any():
            cloud = laspy.LasData(header)
            cloud.x, cloud.y, cloud.z = xyz[own].T
            cloud.classification = classes[own]
            cloud.point_source_id = np.broadcast_to(scan, len(xyz))[own]
            cloud.return_number = cloud.number_of_returns = np.ones(own.sum(), np.uint8)
            cloud.write(str(folder / name))
            clouds.append(str(folder / name))
    at = {name: str(folder / name) for name in ("cloud", "frame", "profile", "dem.tif", "ground")}
    both = ["--cloud", at["cloud"], "--frame", at["frame"]]
    site = ["--site", "here"]
    local = ["--crs", "local", "--units", "metre", "--vertical-units", "metre"]
    assert ingest_cloud.main([*site, *local, "--clouds", *clouds, *both]) == 0
    assert profile_scene.main([*both, "--out", at["profile"]]) == 0
    outputs = ["--dem", at["dem.tif"], "--ground", at["ground"]]
    told = ["--doubts", str(folder / "doubts.json")]
    assert (
        build_dem.main([*site, *both, "--profile", at["profile"], *outputs, *told, *options]) == 0
    )
    doubts = json.loads((folder / "doubts.json").read_text())
    frame = Frame.from_dict(json.loads((folder / "frame").read_text()))
    return {doubt["code"]: doubt for doubt in doubts}, frame


@pytest.fixture
def scene(plane_scene, rng):
    """Flat ground with an unseen square below a roof."""
    scene = plane_scene(side_m=30, density_m2=40)
    roof = np.column_stack([*rng.uniform(10, 20, (2, 3000)), rng.uniform(6.9, 7.0, 3000)])
    roof[:, :2] += scene.xyz_m[:, :2].min(axis=0)
    return scene.with_objects(roof, hidden=lambda x, y: (abs(x - 15) < 5) & (abs(y - 15) < 5))


@pytest.mark.parametrize("kind", ["true", "all ground", "unclassified"])
def test_classes_are_doubted_only_where_geometry_contradicts_them(tmp_path, scene, kind):
    true = np.where(scene.ground, 2, 6)
    classes = {"true": true, "all ground": 2 + 0 * true, "unclassified": 1 + 0 * true}[kind]
    doubts, _ = run(tmp_path, scene.xyz_m, classes.astype(np.uint8))
    doubted = {code for code, doubt in doubts.items() if doubt["severity"] == "doubt"}
    assert doubted & {"classes_contradict", "classes_disagree"} == (
        {"classes_contradict"} if kind == "all ground" else set()
    )
    assert doubts["ground_share"]["measured"] == pytest.approx(scene.ground.mean(), abs=0.01)


def test_the_measured_band_marks_the_cells_with_ground_points(tmp_path, scene):
    _, frame = run(tmp_path, scene.xyz_m, np.where(scene.ground, 2, 6).astype(np.uint8))
    dem = read_raster(tmp_path / "dem.tif", frame)
    assert dem.measured is not None
    ground = read_table(tmp_path / "ground")["ground"].to_numpy()
    assert 0 < dem.measured.sum() <= ground.sum()
    assert np.isfinite(dem.values[dem.measured]).all()
    x, y, _ = frame.to_local(scene.xyz_m[scene.ground]).T
    row = ((dem.north_m - y) / dem.cell_size_m).astype(int)
    column = ((x - dem.west_m) / dem.cell_size_m).astype(int)
    assert dem.measured[row, column].mean() > 0.99


def test_the_published_rule_takes_the_roof_that_hides_its_ground(tmp_path, scene):
    ones = np.ones(len(scene.xyz_m), np.uint8)
    shares = {}
    for method in ("robust", "pillars"):
        folder = tmp_path / method
        folder.mkdir()
        doubts, _ = run(folder, scene.xyz_m, ones, "--method", method)
        found = read_table(folder / "ground")["ground"].to_numpy()
        shares[method] = found.mean()
        assert ("raised_coarse_cell_m" in doubts) is False
    # Below the roof no pillar has ground: its points are the lowest ones.
    assert shares["robust"] == pytest.approx(scene.ground.mean(), abs=0.01)
    assert shares["pillars"] > scene.ground.mean() + 0.08


def test_published_pillars_that_are_raised_are_told(tmp_path, rng):
    xyz = np.column_stack([*rng.uniform(0, 60, (2, 7200)), rng.normal(0, 0.01, 7200)])
    ones = np.ones(len(xyz), np.uint8)
    doubts, _ = run(tmp_path, xyz, ones, "--method", "pillars")
    assert doubts["raised_pillar_width_m"]["measured"] == pytest.approx(2**-0.5, rel=0.05)


@pytest.mark.parametrize("code", ["scans_apart", "ground_doubled", "files_apart"])
def test_scans_apart_reach_the_summary(tmp_path, plane_scene, code):
    scene = plane_scene(side_m=50, density_m2=60, slope_x=0.05)
    xyz, scan = scene.xyz_m, np.arange(len(scene.xyz_m)) % 2
    xyz[:, 2] += 0.06 * (xyz[:, 0] > 20 if code == "files_apart" else scan)
    ones = np.ones(len(xyz), np.uint8)
    east_of = 20 if code == "files_apart" else np.inf
    run(tmp_path, xyz, ones, scan=scan * (code == "scans_apart"), east_of=east_of)
    (tmp_path / "effects").write_text("[]")
    names = ("frame", "profile", "effects", "out", "run")
    paths = [part for name in names for part in (f"--{name}", str(tmp_path / name))]
    about = ["--site", "here", "--seed", "7", "--settings", "{}"]
    assert summarise_site.main([*about, *paths, "--doubts", str(tmp_path / "doubts.json")]) == 0
    told = {
        doubt["code"]: doubt for doubt in json.loads((tmp_path / "out").read_text())["warnings"]
    }
    assert told.keys() & {"scans_apart", "ground_doubled", "files_apart"} == {code}
    assert told[code]["severity"] == "doubt"
    assert told[code]["measured"] == pytest.approx(0.06, abs=0.005)
    assert ("east.laz lies above cloud.laz" in told[code]["message"]) == (code == "files_apart")
