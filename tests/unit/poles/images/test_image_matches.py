import cv2
import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.lens import RadialLens
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.drive.drive_lenses import lens_content
from roadsight.poles.images.image_matches import consecutive, features, matched
from roadsight.stages.poles import match_images

SIZE = 320, 200
SHIFT = np.array([14, 5])


def scenery(seed=3):
    """Spots of many sizes, larger than an image."""
    rng = np.random.default_rng(seed)
    image = np.full((SIZE[1] + 60, SIZE[0] + 60), 120, np.uint8)
    for _ in range(700):
        centre = tuple(int(v) for v in rng.integers(0, [image.shape[1], image.shape[0]]))
        cv2.circle(
            image, centre, int(rng.integers(2, 9)), int(rng.integers(0, 255)), -1, cv2.LINE_AA
        )
    return image


def views():
    image = scenery()
    return image[20:220, 20:340], image[
        20 - SHIFT[1] : 220 - SHIFT[1], 20 - SHIFT[0] : 340 - SHIFT[0]
    ]


def test_what_moved_is_found_where_it_moved_to():
    one, other = map(features, views())
    pairs = matched(one, other)
    assert len(pairs) > 100
    moved = other.uv_px[pairs[:, 1]] - one.uv_px[pairs[:, 0]]
    off = np.abs(moved - SHIFT).max(axis=1)
    assert np.mean(off < 0.3) > 0.95
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)


def test_what_is_turned_is_another_thing():
    one = views()[0]
    assert len(matched(features(one), features(np.rot90(one).copy()))) < 5


@pytest.mark.parametrize(("times", "found"), [(0.5, False), (1.5, True), (2.0, True)])
def test_things_come_nearer(times, found):
    one = views()[0]
    size = int(times * SIZE[0]), int(times * SIZE[1])
    here, there = features(one), features(cv2.resize(one, size, interpolation=cv2.INTER_CUBIC))
    pairs = matched(here, there)
    assert (len(pairs) > 50) == found
    if found:
        off = there.uv_px[pairs[:, 1]] - times * (here.uv_px[pairs[:, 0]] + 0.5) + 0.5
        assert np.mean(np.abs(off).max(axis=1) < 0.5 * times) > 0.9


def test_a_point_is_described_once():
    found = features(views()[0])
    rows = np.column_stack([found.uv_px, found.size_px])
    assert len(np.unique(rows, axis=0)) == len(rows) == len(found.descriptors)


@pytest.mark.parametrize("shape", [(200, 320), (200, 320, 3), (3, 3)])
def test_an_image_without_anything_shares_nothing(shape):
    blank = features(np.full(shape, 90, np.uint8))
    assert matched(blank, features(views()[0])).shape == (0, 2)
    assert matched(blank, blank).shape == (0, 2)


def frames(count=4):
    names = [f"i{k}.png" for k in range(count)]
    return pd.DataFrame(
        {
            "image": names, "path": names, "route": "r", "sequence": np.arange(count),
            "status": "ok", "x": 8.0 * np.arange(count), "y": 0.0,
            "width_px": SIZE[0], "height_px": SIZE[1],
        }
    )  # fmt: skip


def names(table):
    return [(one["image"], other["image"]) for one, other in consecutive(table)]


def test_only_neighbours_of_a_drive_are_compared():
    table = frames(6)
    assert names(table.iloc[::-1]) == [(f"i{k}.png", f"i{k + 1}.png") for k in range(5)]
    assert names(table.assign(status=["ok", "ok", "blurred", "ok", "ok", "ok"]))[1] == (
        "i1.png",
        "i3.png",
    )
    assert len(names(table.assign(route=list("aaabbb")))) == 4
    assert len(names(table.assign(width_px=[9, 9, 9, 8, 8, 8]))) == 4
    assert names(table.assign(x=0.0)) == []
    assert names(table.assign(x=100.0 * np.arange(6))) == []


@pytest.fixture
def folder(tmp_path):
    image = scenery()
    for k in range(4):
        part = image[20 : 20 + SIZE[1], 10 * k : 10 * k + SIZE[0]]
        cv2.imwrite(str(tmp_path / f"i{k}.png"), part)
    write_table(tmp_path / "frames.parquet", frames())
    return tmp_path


def run(folder, out, *more):
    arguments = ["--frames", str(folder / "frames.parquet"), "--images", str(folder)]
    assert match_images.main([*arguments, "--out", str(folder / out), *more]) == 0
    return read_table(folder / out)


def test_shards_hold_what_the_whole_holds(folder, monkeypatch):
    whole = run(folder, "whole.parquet")
    assert set(zip(whole["image"], whole["other"], strict=True)) == set(names(frames()))
    assert np.median(whole["u_other"] - whole["u"]) == pytest.approx(-10.0, abs=0.2)
    monkeypatch.setattr(match_images, "_TOGETHER", 2)
    parts = [run(folder, f"{k}.parquet", "--shard", str(k), "--shards", "3") for k in range(3)]
    together = pd.concat(parts).sort_values(["image", "u", "v"], ignore_index=True)
    assert together.equals(whole.sort_values(["image", "u", "v"], ignore_index=True))


def test_points_are_those_of_a_pinhole(folder):
    lens = RadialLens.centred(-0.08, 0.0, *SIZE)
    content = lens_content(("r", *SIZE), lens, lens.corner_px(*SIZE), 1.0, "measured")
    write_json(folder / "drive.json", {"lenses": [content]})
    plain = run(folder, "plain.parquet")
    straight = run(folder, "straight.parquet", "--drive", str(folder / "drive.json"))
    for names in (["u", "v"], ["u_other", "v_other"]):
        expected = lens.undistort(plain[names].to_numpy())
        np.testing.assert_allclose(straight[names].to_numpy(), expected, atol=1e-9)
    assert not np.allclose(straight["u"], plain["u"], atol=0.5)


def test_a_drive_of_one_image_has_an_empty_table(folder):
    write_table(folder / "frames.parquet", frames(1))
    table = run(folder, "one.parquet")
    assert len(table) == 0 and list(table.columns) == list(match_images.COLUMNS)
