import json

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Calibration, Reach
from roadsight.geometry.cameras import wrap_deg
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.scene_tables import write_terrain
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.alignment.drift import Drift, DriftModel
from roadsight.poles.alignment.drive import loader, near_edges, places_of
from roadsight.poles.alignment.pose import FOCAL, HEIGHT, SIZE, Spread
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.poles.alignment.solve import Fit, ImageEdges, Noise
from roadsight.poles.calibration.calibration import (
    Mount,
    find_focal,
    implausible,
    shared_mean,
    weak_mount,
)
from roadsight.poles.calibration.calibration_table import baseline_mount, from_content, to_content
from roadsight.scene.terrain.tin import Terrain
from roadsight.stages.poles import align_cameras, calibrate_drive
from tests.helpers.road_bed import Mount as BedMount
from tests.helpers.road_bed import RoadBed, edge_table, frames_of

HFOV_DEG = 48.0


@pytest.fixture(scope="module")
def bed():
    return RoadBed(seed=2, images=24, spacing_m=12.0, gps_m=0.5, mount=BedMount(hfov_deg=HFOV_DEG))


@pytest.fixture(scope="module")
def site(tmp_path_factory, bed):
    """Inputs of the stages and a calibration made from them, the lens known to a tenth."""
    folder = tmp_path_factory.mktemp("site")
    frames = frames_of(bed)
    frames.loc[3, "status"] = "standing still"
    write_table(folder / "frames.parquet", frames)
    write_table(folder / "edges.parquet", edge_table(bed))
    xyz = dict(zip("xyz", bed.road_edges.T, strict=True))
    write_table(folder / "road_edges.parquet", frames.iloc[:0].reindex(columns=[]).assign(**xyz))
    write_json(
        folder / "frame.json",
        {"origin": [0, 0, 0], "unit_m": 1.0, "vertical_unit_m": 1.0, "crs_wkt": None},
    )
    out = ["--hfov-deg", "51", "--images", "8", "--out", str(folder / "calibration.json")]
    assert calibrate_drive.main([*_inputs(folder), *out]) == 0
    return folder


def _inputs(folder):
    return [
        "--frames", str(folder / "frames.parquet"),
        "--image-edges", str(folder / "edges.parquet"),
        "--road-edges", str(folder / "road_edges.parquet"),
        "--frame", str(folder / "frame.json"),
    ]  # fmt: skip


def _align(folder, *extra, out="cameras.parquet"):
    code = align_cameras.main(
        [
            *_inputs(folder),
            "--max-sigma-heading-deg",
            "0.25",  # a short bed of few views
            "--calibration",
            str(folder / "calibration.json"),
            "--out",
            str(folder / out),
            *extra,
        ]
    )
    assert code == 0
    return read_table(folder / out)


def test_lens_and_mount_are_found(site, bed):
    (drive,) = read_json(site / "calibration.json")["drives"]
    assert abs(drive["focal_px"] / bed.intrinsics.focal_px - 1) < 0.03
    assert abs(drive["height_m"] - bed.mount.height_m) < 0.12
    assert abs(drive["pitch_deg"] - bed.mount.pitch_deg) < 0.3
    assert drive["problem"] == "" and len(drive["drift"]) >= 20
    again = to_content(from_content(json.loads(json.dumps(drive))))
    assert again == drive


def test_a_pitch_is_no_surer_than_the_principal_points_row(site, bed):
    """The row is where the settings expect it, and a camera that looks up shows the same."""
    table = _align(site)
    (drive,) = read_json(site / "calibration.json")["drives"]
    assert drive["sigma_cy_px"] == Calibration().principal_point_px
    by_cy = np.degrees(drive["sigma_cy_px"] / table["focal_px"])
    np.testing.assert_allclose(table["pitch_by_cy_deg"], by_cy)
    assert (table["sigma_pitch_deg"] > by_cy).all()


def test_cameras_are_right(site, bed):
    table = _align(site)
    assert len(table) == bed.images - 1 and "r1_0003.jpg" not in set(table["image"])
    number = table["image"].str[3:7].astype(int)
    truth = np.array([bed.truth[i].heading_deg for i in number])
    gap = np.abs(wrap_deg(table["heading_deg"] - truth))
    assert table["accepted"].mean() > 0.8
    assert np.mean(gap < 0.15) >= 0.8
    assert (gap[table["accepted"]] < 4 * table["sigma_heading_deg"][table["accepted"]]).all()
    assert set(table.loc[table["accepted"], "reason"]) == {""}


def test_shards_give_the_same_poses(site):
    whole = _align(site).set_index("image")
    parts = [_align(site, "--shard", str(k), "--shards", "3", out=f"{k}.parquet") for k in range(3)]
    for part in parts:
        other = part.set_index("image")
        assert whole.loc[other.index].equals(other)
    assert sum(map(len, parts)) == len(whole)


def test_terrain_that_hides_the_road_is_used(site, bed):
    """A wall across the road 15 m ahead of the first image leaves too few edges to see."""
    centre = np.append(bed.track[0], bed.z_road[0])
    turn = np.radians(bed.truth[0].heading_deg)
    ahead, right = [np.sin(turn), np.cos(turn), 0], [np.cos(turn), -np.sin(turn), 0]
    wall = [centre + 15 * np.array(ahead) + s * np.array(right) for s in (-300, 300)]
    vertices = np.array([wall[0] - [0, 0, 9], wall[1] - [0, 0, 9], wall[0] + [0, 0, 300]])
    write_terrain(site / "wall.npz", Terrain(vertices, np.array([[0, 1, 2]], np.int32)))
    table = _align(site, "--terrain", str(site / "wall.npz"), out="wall.parquet")
    assert not table["accepted"].iloc[0]
    assert table["reason"].iloc[0] != ""


def test_none_is_the_track_and_the_mount(site):
    table = _align(site, "--method", "none")
    assert table["accepted"].all()
    assert (table["sigma_heading_deg"] > 0.2).all()


def test_edge_tables_may_be_empty(site):
    empty = read_table(site / "edges.parquet").iloc[:0]
    write_table(site / "none.parquet", empty)
    arguments = [*_inputs(site), "--out", str(site / "bare.json"), "--hfov-deg", "48"]
    arguments[3] = str(site / "none.parquet")
    assert calibrate_drive.main(arguments) == 0
    (drive,) = read_json(site / "bare.json")["drives"]
    assert "too few images" in drive["problem"] and drive["drift"] == []


def test_bad_inputs_are_one_message(site, capsys):
    frames = read_table(site / "frames.parquet")
    write_table(site / "bad.parquet", frames.assign(status="off the road"))
    arguments = [*_inputs(site), "--out", str(site / "x.json")]
    arguments[1] = str(site / "bad.parquet")
    assert calibrate_drive.main(arguments) == 2
    assert "no image that may be used" in capsys.readouterr().err


def quadratic_fits(rng, mean, count, spread):
    """Images whose misfit is exactly quadratic, about unknowns drawn around the mean."""
    for _ in range(count):
        own = mean + rng.normal(size=SIZE) * spread.vector()
        rows = rng.normal(size=(SIZE + 4, SIZE)) / spread.vector()
        normal = 25.0 * rows.T @ rows
        seen = own + np.linalg.cholesky(np.linalg.inv(normal)) @ rng.normal(size=SIZE)
        yield Fit(seen, np.linalg.inv(normal), 0.0, np.zeros((50, 2)), normal, np.zeros(SIZE))


def test_shared_mean_of_quadratic_misfits(rng):
    spread, prior = Spread(), weak_mount(50.0, 2000)
    truth = prior.mean + 0.3 * np.sqrt(np.diag(prior.covariance))
    fits = list(quadratic_fits(rng, truth, 60, spread))
    found = shared_mean(fits, prior, spread)
    gap = (found.mean - truth) / np.sqrt(np.diag(found.covariance))
    assert np.abs(gap).max() < 4.0
    fits[0] = Fit(fits[0].unknowns + 30 * spread.vector(), *list(vars(fits[0]).values())[1:])
    off = shared_mean(fits, prior, spread)
    assert (np.abs(off.mean - found.mean) < 2 * np.sqrt(np.diag(found.covariance))).all()


def test_baseline_replaces_the_prior():
    prior = weak_mount(None, 1000)
    mount = baseline_mount(
        {"hfov_deg": 90.0, "pitch_deg": 2.0, "sigma": {"pitch_deg": 0.1}}, prior, 1000
    )
    assert np.exp(mount.mean[FOCAL]) == pytest.approx(500.0)
    assert mount.covariance[4, 4] == pytest.approx(0.01)
    with pytest.raises(InputError, match="baseline"):
        baseline_mount({"focal_px": -3.0}, prior, 1000)


def test_the_lens_is_found_from_nothing(bed):
    edges = RoadEdges.from_points(bed.road_edges)
    places = places_of(frames_of(bed), edges)
    reach = Reach(edge_points=300, pixels=120)
    rows = [ImageEdges.from_pixels(r[:, :2], r[:, 2], r[:, 3] > 0.5, 120) for r in bed.seen]
    loaders = [
        loader(p, r, near_edges(p, edges, reach), Noise())
        for p, r in list(zip(places, rows, strict=True))[::4]
    ]
    prior = weak_mount(None, bed.width_px)
    found = find_focal(loaders, prior, Spread(), bed.width_px, (25.0, 90.0))
    assert abs(np.exp(found.mean[FOCAL]) / bed.intrinsics.focal_px - 1) < 0.1


def test_drift_leaves_the_image_itself_out():
    station = np.arange(0.0, 100.0, 10.0)
    offset = np.tile([0.6, -0.3], (10, 1))
    offset[4] = [5.0, 5.0]
    drift = Drift(station, offset, np.tile(np.eye(2) * 0.04, (10, 1, 1)), DriftModel())
    mean, covariance = drift.at(40.0, leave_out=4)
    np.testing.assert_allclose(mean, [0.6, -0.3], atol=0.1)
    assert np.sqrt(covariance[0, 0]) < 0.4
    kept, which = drift.without_outliers()
    assert not which[4] and which.sum() >= 8
    nothing, wide = kept.at(1e5)
    assert (nothing == 0).all() and wide[0, 0] == pytest.approx(0.8**2 + 0.2**2)


def test_mount_expects_more_spread_than_it_has():
    mount = Mount(np.zeros(SIZE), np.eye(SIZE))
    assert (np.diag(np.linalg.inv(mount.expected(Spread()))) > 1.0).all()


@pytest.mark.parametrize(
    ("hfov_deg", "height_m", "word"),
    [(60.0, 2.2, ""), (20.0, 1.2, ""), (4.0, 2.2, "field of view"), (150.0, 2.2, "field of view"),
     (60.0, 0.1, "above the road"), (60.0, 9.0, "above the road")],
)  # fmt: skip
def test_cameras_that_no_vehicle_carries_are_told(hfov_deg, height_m, word):
    mount = weak_mount(hfov_deg, 1200)
    mount.mean[HEIGHT] = height_m
    found = implausible(mount, 1200)
    assert (word in found) and (bool(found) == bool(word))
