import hashlib
import zipfile
from functools import partial

import cv2
import numpy as np
import pandas as pd
import pytest

from roadsight.io.images.camera_tables import read_baselines
from roadsight.io.images.image_shards import ImageShard, JpegShardWriter
from roadsight.io.records.text_tables import write_csv
from roadsight.stages.scene import generate_rural, render_videolog
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives

LENGTH = ["--length-m", "60", "--seed", "2"]


@pytest.fixture(autouse=True)
def cheap(monkeypatch):
    """Few leaves and small images."""
    for stage in (generate_rural, render_videolog):
        monkeypatch.setattr(stage, "build_rural", partial(build_rural, detail=0.01))
    small = partial(random_drives, narrow_px=(96, 64), wide_px=(80, 56))
    monkeypatch.setattr(render_videolog, "random_drives", small)


def generate(folder):
    folder.mkdir()
    names = {"cloud": "c.laz", "truth": "t.gpkg", "poles": "p.csv", "videolog": "v.csv"}
    names |= {"cameras": "k.csv", "baseline": "b.json"}
    files = [part for key, name in names.items() for part in (f"--{key}", str(folder / name))]
    assert generate_rural.main([*LENGTH, "--pulses-per-m2", "0.5", *files]) == 0
    return {n: hashlib.sha256((folder / n).read_bytes()).hexdigest() for n in names.values()}


def test_generate_twice_gives_the_same_bytes(tmp_path):
    one, two = generate(tmp_path / "a"), generate(tmp_path / "b")
    assert one == two
    table = pd.read_csv(tmp_path / "a" / "v.csv", keep_default_na=False)
    assert list(table.columns) == [
        "image", "left_image", "right_image", "latitude", "longitude", "route", "sequence",
    ]  # fmt: skip
    text = (tmp_path / "a" / "v.csv").read_text().splitlines()[1].split(",")
    assert len(text[3].split(".")[1]) == 7


def test_the_baseline_is_one_true_camera_rounded_to_what_an_eye_sets(tmp_path):
    generate(tmp_path / "a")
    found = read_baselines(tmp_path / "a" / "b.json")
    cameras = pd.read_csv(tmp_path / "a" / "k.csv").query("view == 'front'")
    assert set(found) == {"640x416", "640x448"}
    for (route, width, height), own in cameras.groupby(["route", "width_px", "height_px"]):
        stated, true = found[f"{width}x{height}"], own.iloc[len(own) // 2]
        hfov_deg = np.degrees(2 * np.arctan2(0.5 * width, true["focal_px"]))
        assert stated["hfov_deg"] == pytest.approx(hfov_deg, abs=0.051), route
        assert stated["height_m"] == pytest.approx(true["height_above_road_m"], abs=0.051)
        assert abs(stated["yaw_deg"]) < 4 and abs(stated["pitch_deg"]) < 4
        numbers = [v for n, v in stated.items() if n not in ("sigma", "images")]
        assert all(round(value, 1) == value for value in numbers)
        assert stated["images"] == 1


def test_shards_hold_every_image_once(tmp_path):
    held = {}
    for shard in (0, 1):
        paths = {key: tmp_path / f"{key}{shard}.zip" for key in ("images", "labels", "depth")}
        files = [part for key, path in paths.items() for part in (f"--{key}", str(path))]
        assert render_videolog.main([*LENGTH, "--shards", "2", "--shard", str(shard), *files]) == 0
        with zipfile.ZipFile(paths["images"]) as images:
            held |= {name: images.read(name) for name in images.namelist()}
        labels, depth = ImageShard(paths["labels"]), ImageShard(paths["depth"])
        assert labels.names == depth.names
        if labels.names:
            assert labels.read(labels.names[0]).dtype == np.uint8
            assert depth.read(labels.names[0]).dtype == np.uint16
    assert len(held) == 8 * 3 + 4
    assert {"sr1427e_0001.jpg", "sr1427e_0001_left.jpg", "sr1427w_0004.jpg"} <= set(held)
    picture = cv2.imdecode(np.frombuffer(held["sr1427e_0001.jpg"], np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (64, 96, 3)


def test_a_jpeg_shard_repeats_and_appears_whole(tmp_path):
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    for name in ("a.zip", "b.zip"):
        with JpegShardWriter(tmp_path / name) as shard:
            shard.write("x.jpg", image)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with pytest.raises(RuntimeError), JpegShardWriter(tmp_path / "c.zip") as shard:
        shard.write("x.jpg", image)
        raise RuntimeError
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.zip", "b.zip"]


def test_csv_has_fixed_digits_and_no_negative_zero(tmp_path):
    write_csv(tmp_path / "t.csv", pd.DataFrame({"a": [-0.00001, 1.0], "b": ["x", ""]}), {"a": 3})
    assert (tmp_path / "t.csv").read_text() == "a,b\n0.000,x\n1.000,\n"


def test_bad_seed_is_one_message(tmp_path, capsys):
    assert render_videolog.main(["--seed", "-1", "--images", str(tmp_path / "i.zip")]) == 2
    assert "seed" in capsys.readouterr().err
