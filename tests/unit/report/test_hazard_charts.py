import re

import numpy as np
import pandas as pd

from roadsight.report.poles.hazard_charts import MOST, hazard_profiles, profile_chart

ELEMENTS = [
    ("shoulder", 0.0, 1.2, -0.06, "1V:20.0H"), ("drop-off", 1.2, 1.2, -0.1, ""),
    ("foreslope", 1.2, 3.0, -0.8, "1V:2.2H"), ("ditch bottom", 3.0, 3.6, 0.0, "level"),
    ("backslope", 3.6, 5.0, 0.6, "1V:2.3H"), ("level", 5.0, 12.0, 0.05, "level"),
]  # fmt: skip


def table(n=3, rating="high"):
    hazard = pd.DataFrame(
        {
            "id": [f"p{i}" for i in range(n)], "kind": "pole", "rank": np.arange(n, 0, -1),
            "rating": rating, "route": "SR <7>", "station_m": 10.0, "side": -1, "offset_m": 4.0,
            "clear_zone_m": 8.0, "reasons": "4 m from the edge <b>",
        }
    )  # fmt: skip
    rows = [(name, *element) for name in hazard["id"] for element in ELEMENTS]
    columns = ["object", "kind", "start_m", "end_m", "rise_m", "slope_ratio"]
    run = np.arange(0, 12, 0.5)
    profiles = {
        name: {"run_m": run.tolist(), "height_m": (0 * run).tolist()} for name in hazard["id"]
    }
    return hazard, pd.DataFrame(rows, columns=columns), profiles


def test_the_worst_come_first_and_others_are_left_out():
    found = hazard_profiles(*table(MOST + 5))
    assert len(found) == MOST
    assert [one["rank"] for one in found[:3]] == [1, 2, 3]
    assert hazard_profiles(*table(rating="low")) == []
    hazard, sections, profiles = table()
    assert hazard_profiles(hazard, sections, {"p1": profiles["p1"]})[0]["id"] == "p1"
    assert hazard_profiles(hazard, pd.DataFrame(), profiles) == []
    assert hazard_profiles(hazard.drop(columns="reasons"), sections, profiles) == []


def test_a_drawing_is_to_scale_and_its_texts_are_safe():
    profile = hazard_profiles(*table())[0]
    svg = profile_chart(profile)
    assert "<b>" not in svg
    assert "drop-off 0.10 m" in svg
    assert "clear zone 8.0 m" in svg
    line = re.search(r'class="line fit" d="([^"]+)"', svg).group(1)
    places = np.array([[float(v) for v in p.split()] for p in re.findall(r"[ML]([^ML]+)", line)])
    ends = places[5] - places[4]
    assert np.isclose(ends[0] / 1.8, ends[1] / 0.8, rtol=0.02)


def test_a_clear_zone_that_is_a_range_has_two_ends_and_keeps_its_objects():
    hazard, sections, profiles = table(rating="medium")
    hazard = hazard.assign(clear_zone_least_m=3.0, clear_zone_greatest_m=8.0)
    assert hazard_profiles(hazard.assign(rating_greatest="medium"), sections, profiles) == []
    found = hazard_profiles(hazard.assign(rating_greatest="high"), sections, profiles)
    assert len(found) == 3
    svg = profile_chart(found[0])
    assert "clear zone 3.0 to 8.0 m" in svg
    assert svg.count('class="line reference"') == 2


def test_labels_of_narrow_elements_take_rows_of_their_own():
    profile = hazard_profiles(*table())[0]
    notes = re.findall(
        r'class="note" x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]+)<', profile_chart(profile)
    )
    boxes = [
        (float(x), float(y), 6.0 * len(text) / 2) for x, y, text in notes if "zone" not in text
    ]
    assert len(boxes) == len(ELEMENTS)
    for n, (x, y, half) in enumerate(boxes):
        for other_x, other_y, other_half in boxes[n + 1 :]:
            assert abs(y - other_y) > 10 or abs(x - other_x) >= half + other_half


def test_an_object_of_unknown_offset_is_drawn_without_a_bar():
    profile = hazard_profiles(*table())[0] | {"offset_m": None, "clear_zone_m": [None, None]}
    svg = profile_chart(profile)
    assert "object" not in svg
    assert "clear zone" not in svg
