import json

import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.io.images.intrinsics import read_intrinsics

IMAGES = [("a.jpg", 1242, 375), ("b.jpg", 1242, 375)]
ROW = {"fx_px": 721.5, "fy_px": 721.5, "cx_px": 609.6, "cy_px": 172.9}


def table(tmp_path, *rows):
    path = tmp_path / "lens.csv"
    pd.DataFrame(rows).to_csv(path, index=False)
    return str(path)


def refused(source, images=IMAGES):
    with pytest.raises(InputError) as caught:
        read_intrinsics(source, images)
    return str(caught.value)


def test_one_row_is_for_all_images(tmp_path):
    found = read_intrinsics(table(tmp_path, ROW | {"sigma_fx_px": 2.0, "sigma_cx_px": 1.0}), IMAGES)
    assert set(found) == {"a.jpg", "b.jpg"}
    lens = found["a.jpg"]
    assert (lens.focal_px, lens.cx_px, lens.cy_px) == (721.5, 609.6, 172.9)
    assert (lens.sigma_focal_px, lens.sigma_cx_px, lens.sigma_cy_px) == (2.0, 1.0, 0.0)


def test_a_row_for_each_image(tmp_path):
    rows = [{"image": name, **ROW, "fx_px": 720.0 + n} for n, name in enumerate("ab")]
    rows = [row | {"image": row["image"] + ".jpg", "fy_px": row["fx_px"]} for row in rows]
    found = read_intrinsics(table(tmp_path, *rows), IMAGES)
    assert [found[name].focal_px for name, _, _ in IMAGES] == pytest.approx([720.0, 721.0])


def test_a_row_as_json_and_fy_that_is_absent():
    row = {name: value for name, value in ROW.items() if name != "fy_px"} | {"width_px": None}
    assert read_intrinsics(json.dumps(row), IMAGES)["b.jpg"].focal_px == 721.5


def test_a_table_with_some_images_only(tmp_path):
    told = refused(table(tmp_path, {"image": "a.jpg", **ROW}))
    assert "some images only" in told and "1 of 2 images; b.jpg is missing" in told
    assert "poles.intrinsics" in told and "lens.csv" in told


def test_several_rows_without_names(tmp_path):
    assert "no column image" in refused(table(tmp_path, ROW, ROW))


def test_an_image_twice(tmp_path):
    twice = {"image": "a.jpg", **ROW}
    assert "twice; found a.jpg" in refused(table(tmp_path, twice, twice))


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"width_px": 621, "height_px": 188}, "found 621 x 188 px; allowed: 1242 x 375 px"),
        ({"cx_px": 1219.2, "cy_px": 345.8}, "principal point contradicts the image's size"),
        ({"cx_px": 304.8, "cy_px": 86.5}, "principal point contradicts the image's size"),
        ({"fx_px": 100.0, "fy_px": 100.0}, "focal length contradicts the image's size"),
        ({"fx_px": 721.5, "fy_px": 700.0}, "pixels are not square"),
        ({"fx_px": -721.5}, "must be positive"),
        ({"sigma_cx_px": -1.0}, "must be positive"),
        ({"cx_px": "nan"}, "no finite number"),
        ({"cx_px": "middle"}, "no finite number"),
    ],
)
def test_what_is_no_lens_of_these_images(tmp_path, changed, told):
    assert told in refused(table(tmp_path, ROW | changed))


@pytest.mark.parametrize("column", ["fx_px", "cx_px", "cy_px"])
def test_a_column_that_is_missing(tmp_path, column):
    left = {name: value for name, value in ROW.items() if name != column}
    assert "lacks a column" in refused(table(tmp_path, left))


def test_an_empty_table(tmp_path):
    path = tmp_path / "lens.csv"
    path.write_text("fx_px,cx_px,cy_px\n")
    assert "lens.csv" in refused(str(path))
