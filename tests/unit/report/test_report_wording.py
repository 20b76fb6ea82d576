import json

import pytest

from roadsight.config.schema import Settings
from roadsight.report import wording
from roadsight.report.parameters import figure_rows, setting_groups, settings_asked_for
from roadsight.report.wording import (
    MISSING,
    bearing,
    counted,
    label,
    lower_first,
    metres,
    number,
    percent,
    quantity,
    seconds,
)


def plain(text):
    """Text with ordinary spaces and signs."""
    return text.replace("\u202f", " ").replace("\u2212", "-").replace("\u00d7", "x")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0, "0"), (-0.0, "0"), (1234567, "1,234,567"), (12345.678, "12,346"), (16.389999, "16.39"),
        (0.5, "0.5"), (0.13928, "0.1393"), (0.00012345, "0.0001234"), (1.2e-7, "1.2e-07"),
        (-2.5, "-2.5"), (9999.96, "10,000"), (float("nan"), MISSING), (float("inf"), MISSING),
    ],
)  # fmt: skip
def test_number(value, shown):
    assert plain(number(value)) == shown


@pytest.mark.parametrize(
    ("value", "decimals", "shown"),
    [(5428027.004, 2, "5,428,027.00"), (-0.0004, 2, "0.00"), (-1.5, 1, "-1.5"), (3, 1, "3.0")],
)
def test_number_with_decimals(value, decimals, shown):
    assert plain(number(value, decimals)) == shown


@pytest.mark.parametrize(
    ("share", "shown"),
    [
        (0, "0 %"), (1, "100 %"), (0.0001, "< 0.1 %"), (0.99996, "> 99.9 %"), (0.0444, "4.4 %"),
        (0.6, "60 %"),
    ],
)  # fmt: skip
def test_percent_reaches_its_ends_only_when_it_is_there(share, shown):
    assert plain(percent(share)) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, MISSING), (0.01, "< 0.1 s"), (0.44, "0.4 s"), (119.96, "120.0 s"), (150, "2.5 min")],
)
def test_seconds(value, shown):
    assert plain(seconds(value)) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0, "0° N"), (359.7, "0° N"), (337.5, "338° N"), (337, "337° NW"), (135, "135° SE"),
        (22, "22° N"), (23, "23° NE"),
    ],
)  # fmt: skip
def test_bearing_wraps(value, shown):
    assert bearing(value) == shown


def test_metres():
    assert plain(metres(8.25, 2)) == "8.25 m"
    assert metres(None) == MISSING


def test_counted():
    told = [counted(n, "target") for n in (0, 1, 2000)]
    assert told == ["0 targets", "1 target", "2,000 targets"]
    assert counted(2, "entry", "entries") == "2 entries"


@pytest.mark.parametrize(
    ("key", "value", "shown"),
    [
        ("pillar_width_m", 0.2, "0.2 m"),
        ("area_m2", 15028.0, "15,028 m²"),
        ("density_per_m2", 27.0, "27 /m²"),
        ("azimuth_step_deg", 0.1, "0.1°"),
        ("overhead_cover_share", 0.1148, "11.5 %"),
        ("f1", 0.9605, "96 %"),
        ("model", "surfel", "surfel"),
        ("has_colour", True, "yes"),
        ("price", None, MISSING),
        ("extent_m", [150.0, 100.0, 23.28], "150 m x 100 m x 23.28 m"),
        ("elevations_deg", [-15.0, 15.0], "-15°, 15°"),
        ("elevations_deg", [], MISSING),
        ("m", 3, "3"),
    ],
)
def test_quantity(key, value, shown):
    assert plain(quantity(key, value)) == shown


@pytest.mark.parametrize(
    ("key", "shown"),
    [
        ("pillar_width_m", "Pillar width"),
        ("dem_cell_m", "DEM cell"),
        ("overhead_cover_share", "Cells with overhead cover"),
        ("smallest_part_share", "Smallest part share"),
        ("p95", "95th percentile"),
        ("cost", "Cost"),
    ],
)
def test_label(key, shown):
    assert label(key) == shown


def test_lower_first_keeps_abbreviations():
    told = [lower_first(t) for t in ("Cell", "CRS", "F1 score", "")]
    assert told == ["cell", "CRS", "F1 score", ""]


def test_figures_of_any_nesting():
    figures = {
        "density_per_m2": {"median": 27.0, "p05": 15.0, "cell_m": 1.0},
        "class_shares": {"2": 0.72},
        "nothing": None,
        "empty": {},
    }
    rows = [(row.label, plain(row.value)) for row in figure_rows(figures)]
    assert rows == [
        ("Density, median", "27 /m²"),
        ("Density, 5th percentile", "15 /m²"),
        ("Density, cell", "1 m"),
        ("Cells with class 2, ground", "72 %"),
    ]


def test_every_setting_is_shown_with_its_meaning():
    settings = json.loads(Settings().model_dump_json())
    rows = [row for group in setting_groups(settings) for row in group.rows]
    leaves = {
        f"{section}.{key}" if isinstance(content, dict) else section
        for section, content in settings.items()
        for key in (content if isinstance(content, dict) else [section])
    }
    assert {row.key for row in rows} == leaves
    assert all(row.about and row.value for row in rows)


def test_settings_of_poles_are_shown_where_there_are_poles():
    settings = json.loads(Settings().model_dump_json())
    both = settings_asked_for({"settings": settings, "placement": {}, "poles": {}})
    assert both == setting_groups(settings)
    titles = {group.title for group in settings_asked_for({"settings": settings, "placement": {}})}
    left_out = {group.title for group in both} - titles
    assert len(left_out) >= 10 and all("oles" in title for title in left_out)


def test_settings_follow_the_schema_whatever_their_order():
    settings = json.loads(Settings().model_dump_json())
    shuffled = {
        name: dict(reversed(part.items())) if isinstance(part, dict) else part
        for name, part in reversed(settings.items())
    }
    assert setting_groups(shuffled) == setting_groups(settings)


def test_setting_that_the_schema_does_not_know():
    groups = setting_groups({"seed": 1, "rain": {"rate_mm": 3}, "zeal": True})
    assert [group.title for group in groups] == ["General", "Rain"]
    assert groups[0].rows[1].about == ""
    assert groups[1].rows[0].key == "rain.rate_mm"


def test_poses_are_told_in_words():
    assert wording.pose(-10.0, 0.0) == "10° down"
    assert wording.pose(5.0, 0.0) == "5° up"
    assert wording.pose(0.0, -2.5) == "level, roll \u22122.5°"


def test_mappings_and_lists_of_them_are_told_with_their_names():
    assert wording.quantity("camera", {"yaw_deg": [-70.0, 0.0], "pitch_deg": [-10.0]}) == (
        "yaw \u221270°, 0°; pitch \u221210°"
    )
    zones = [{"half_angle_deg": 9, "range_m": 250}]
    assert wording.quantity("zones", zones) == "half angle 9°; range 250\u202fm"


def test_a_share_that_is_not_known_is_no_number():
    assert wording.percent(None) == wording.MISSING
