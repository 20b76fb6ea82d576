import json

import cv2
import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import write_table
from roadsight.stages.evidence.match_inputs import main
from tests.helpers.las_files import wkt_of

FRAME = Frame((500_000.0, 5_400_000.0, 200.0), crs_wkt=wkt_of("EPSG:32632"))
LON, LAT = 9.0002, 48.7531
"""A place at the site."""


@pytest.fixture
def site(tmp_path):
    about = FRAME.to_dict() | {"bounds_m": [0, 0, 0, 300, 60, 9]}
    write_json(tmp_path / "frame.json", about)
    images = [f"a{n}.jpg" for n in range(5)]
    table = {"image": images, "path": images, "left_path": "", "right_path": "", "status": "ok"}
    write_table(tmp_path / "frames.parquet", pd.DataFrame(table))
    (tmp_path / "masks").mkdir()
    for name in ("a0", "a1", "b"):
        cv2.imwrite(str(tmp_path / f"masks/{name}.png"), np.zeros((2, 3), np.uint8))
    (tmp_path / "c.csv").write_text("image,x\na0.jpg,1\na1.jpg,1\n")
    (tmp_path / "few.csv").write_text("image,x\na0.jpg,1\nb.jpg,1\nc.jpg,1\n")
    write_points(tmp_path / "points.geojson", [(LON, LAT)] * 4)
    write_points(tmp_path / "far.geojson", [(LON, LAT), (LON + 1, LAT)])
    write_points(tmp_path / "swapped.geojson", [(LAT, LON)])
    return tmp_path


def write_points(path, places):
    features = [
        {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": place}}
        for place in places
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def match(site, *lists):
    given = [
        {"kind": kind, "what": "things", "path": str(site / name), "crs": None}
        for kind, name in lists
    ]
    arguments = ["--frame", str(site / "frame.json"), "--frames", str(site / "frames.parquet")]
    arguments += ["--lists", json.dumps(given), "--doubts", str(site / "doubts.json")]
    return main(arguments)


def test_what_matches_is_no_doubt(site):
    assert match(site, ("places", "points.geojson"), ("images", "c.csv")) == 0
    assert read_json(site / "doubts.json") == []


def test_few_matches_of_each_kind_are_doubts(site):
    lists = ("places", "far.geojson"), ("images", "few.csv"), ("folder", "masks")
    assert match(site, *lists) == 0
    found = read_json(site / "doubts.json")
    assert [round(doubt["measured"], 2) for doubt in found] == [0.5, 0.33, 0.4]
    assert "left out: a2.jpg, a3.jpg, a4.jpg" in found[2]["message"]


def test_no_match_is_refused_with_the_reason(site, capsys):
    assert match(site, ("places", "swapped.geojson")) == 2
    assert "axes exchanged" in capsys.readouterr().err
    assert not (site / "doubts.json").exists()
