import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.evidence import published
from roadsight.report.charts import MOST, Chart, hazard_profiles, profile_chart, span_of, ticks

numbers = st.floats(-1e6, 1e6)


@given(numbers, st.floats(1e-3, 1e6))
def test_ticks_are_even_inside_and_few(low, width):
    found = ticks((low, low + width))
    assert 2 <= len(found) <= 11
    assert all(low - 1e-6 * width <= tick <= low + width + 1e-6 * width for tick in found)
    steps = {round((b - a) / width, 5) for a, b in pairwise(found)}
    assert max(steps) - min(steps) < 2e-5


@given(st.lists(st.one_of(st.none(), numbers), max_size=20))
def test_span_holds_every_value_and_is_never_empty(values):
    low, high = span_of(values)
    assert low < high
    assert all(low <= value <= high for value in values if value is not None)


def test_span_leaves_out_a_wild_value():
    assert span_of([*[1.0] * 200, 2.0, 1e6], share=0.98)[1] < 10


def chart():
    return Chart("Title & more", "x", "y", (0.0, 10.0), (0.0, 1.0), 200.0, 100.0)


def test_chart_is_well_formed_and_named():
    made = chart()
    made.dots([1.0], [0.5], "good", ["<pole> & co"])
    made.bars([0.0, 1.0, 2.0], [1, 0], "good")
    made.level(0.5, "fit", "half < 1")
    root = ElementTree.fromstring(made.svg())
    assert root.get("aria-label") == "Title & more"
    assert "<pole> & co" in "".join(root.itertext())
    assert "half < 1" in "".join(root.itertext())


def test_line_breaks_where_values_are_missing():
    made = chart()
    made.line([0.0, 1.0, 2.0, 3.0], [0.1, None, float("nan"), 0.4], "good")
    path = re.search(r'class="line good" d="([^"]*)"', made.svg()).group(1)
    assert path.count("M") == 2
    assert "L" not in path


def test_band_needs_both_sides_of_two_neighbours():
    made = chart()
    made.band([0.0, 1.0, 2.0, 3.0], [0.1, 0.1, None, 0.1], [0.2, 0.2, 0.2, 0.2], "sigma")
    assert made.svg().count('class="band sigma"') == 1


def test_dots_are_where_their_values_are():
    made = chart()
    made.dots([0.0, 10.0], [0.0, 1.0], "good", ["a", "b"])
    places = re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', made.svg())
    (x0, y0), (x1, y1) = ([float(v) for v in place] for place in places)
    assert x0 < x1
    assert y0 > y1
    made.dots([5.0], [99.0], "good", ["beyond"])
    assert re.findall(r'cy="([\d.]+)"', made.svg())[-1] == places[1][1]


def test_level_outside_the_plot_is_not_drawn():
    made = chart()
    made.level(2.0, "reference", "far")
    assert "far" not in made.svg()


def test_papers_table_agrees_with_its_own_text():
    poles, mean = published.scenario_mean_m("Extraneous_features")
    assert (poles, round(mean, 2)) == (4, 14.55)
    straight, curved = (published.scenario_mean_m(name) for name in published.SCENARIOS[:2])
    assert straight[0] + curved[0] == published.CHECKED
    mean = (straight[0] * straight[1] + curved[0] * curved[1]) / published.CHECKED
    assert mean == pytest.approx(published.MEAN_M, abs=0.06)
    assert published.scenario_mean_m("tunnel") is None


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(0, 1)), min_size=1, max_size=12))
def test_labels_cover_no_other_one_and_stay_inside(places):
    made = Chart("t", "x", "y", (0.0, 10.0), (0.0, 1.0))
    for number, place in enumerate(places):
        made.label(*place, f"level {number}")
    notes = re.findall(
        r'class="note" x="([-\d.]+)" y="([-\d.]+)" text-anchor="(\w+)">([^<]*)<', made.svg()
    )
    assert notes[0][3] == "level 0"
    boxes = []
    for x, y, anchor, text in notes:
        left = float(x) - (0 if anchor == "start" else 5.5 * len(text))
        boxes.append((left, float(y) - 10, left + 5.5 * len(text), float(y)))
    for number, (left, top, right, bottom) in enumerate(boxes):
        assert left >= 0 and right <= 470 and top >= -1 and bottom <= 270
        for other in boxes[:number]:
            apart = left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1]
            assert apart


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
