import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from roadsight.geometry.frames import Frame
from roadsight.geometry.north import bearing_deg, longitudes_latitudes
from roadsight.report.site.cautions import (
    data_cautions,
    is_proven,
    page_cautions,
    plan_cautions,
    scene_cautions,
    told_cautions,
)
from roadsight.report.site.page import (
    NOT_CHOSEN,
    OUT_OF_SIGHT,
    TOO_FEW,
    gaps_of,
    objects_in_the_way,
    obstacles_of,
    sights_of,
)

TARGETS = pd.DataFrame(
    {"target": ["a", "b", "c", "d"], "x": [0.0, 3, 6, 9], "y": [0.0, 0, 0, 0], "z": [0.0, 0, 0, 0]}
)


def detections(*rows):
    return pd.DataFrame(rows, columns=["sensor", "candidate", "target"])


def sensor(name, candidate, x=0.0, z=4.0):
    return {"sensor": name, "candidate": candidate, "x": x, "y": 0.0, "z": z}


class TestSights:
    seen = detections(
        ("A", "p1", "a"), ("A", "p1", "b"), ("A", "p2", "b"), ("B", "p1", "d"), ("A", "p3", "c")
    )

    def test_only_the_chosen_sensors_count(self):
        sights = sights_of([sensor("A", "p1"), sensor("A", "p2")], self.seen, TARGETS)
        assert sights.times_seen.tolist() == [1, 2, 0, 0]
        assert sights.histogram.tolist() == [2, 1, 1]
        assert sights.seen_by(0).tolist() == [0, 1]
        # Another sensor at the same place is another choice.
        assert sights_of([sensor("B", "p1")], self.seen, TARGETS).seen_by(0).tolist() == [3]
        assert sights_of([], self.seen, TARGETS).histogram.tolist() == [4]
        more = pd.concat([self.seen, self.seen, detections(("A", "p1", "gone"))])
        once = sights_of([sensor("A", "p1")], more, TARGETS)
        assert once.times_seen.tolist() == [1, 1, 0, 0]

    def test_figures(self):
        sights = sights_of([sensor("A", "p1", x=3.0), sensor("A", "p2")], self.seen, TARGETS)
        assert sights.figures(0) == {
            "targets": 2,
            "only": 1,
            "range_mean_m": pytest.approx(4.5),
            "range_max_m": pytest.approx(5.0),
        }
        assert sights.figures(1)["only"] == 0

    def test_sensor_that_sees_nothing(self):
        sights = sights_of([sensor("A", "p9")], self.seen, TARGETS)
        nothing = {"targets": 0, "only": 0, "range_mean_m": None, "range_max_m": None}
        assert sights.figures(0) == nothing

    def test_sensor_at_a_target_has_range_zero(self):
        sights = sights_of([sensor("A", "p1", z=0.0)], self.seen, TARGETS)
        assert sights.figures(0)["range_mean_m"] == pytest.approx(1.5)

    def test_matches_plain_counting(self, rng):
        names = [f"t{n}" for n in range(60)]
        targets = pd.DataFrame({"target": names, "x": rng.uniform(0, 90, 60), "y": 1.0, "z": 0.0})
        places = [sensor("AB"[n % 2], f"p{n}", x=5.0 * n) for n in range(9)]
        rows = [
            (p["sensor"], p["candidate"], t) for p in places for t in names if rng.random() < 0.2
        ]
        sights = sights_of(places, detections(*rows), targets)
        for n, place in enumerate(places):
            own = [t for s, c, t in rows if (s, c) == (place["sensor"], place["candidate"])]
            alone = [t for t in own if sum(other == t for *_, other in rows) == 1]
            figures = sights.figures(n)
            assert (figures["targets"], figures["only"]) == (len(own), len(alone))


class TestPlaces:
    def test_degrees_of_a_known_place(self):
        frame = Frame((458000.0, 5428000.0, 0.0), crs_wkt=CRS.from_epsg(25832).to_wkt())
        (found,) = longitudes_latitudes(frame, np.array([[1000.0, 2000.0]]))
        assert found == pytest.approx([8.43919, 49.02156], abs=1e-4)

    def test_local_site_has_none(self):
        assert longitudes_latitudes(Frame((0.0, 0.0, 0.0)), np.zeros((2, 2))) is None

    def test_no_place(self):
        frame = Frame((458000.0, 5428000.0, 0.0), crs_wkt=CRS.from_epsg(25832).to_wkt())
        assert longitudes_latitudes(frame, np.empty((0, 2))).shape == (0, 2)

    @pytest.mark.parametrize(
        ("yaw", "bearing"), [(0, 90), (90, 0), (180, 270), (-90, 180), (-180, 270), (135, 315)]
    )
    def test_bearing(self, yaw, bearing):
        assert bearing_deg(yaw) == bearing


class TestGaps:
    explained = pd.DataFrame(
        {
            "target": ["b", "d"], "reason": ["too few beams", "hidden"], "nearest_m": [80.5, 12.5],
            "blocked_share": [0.0, 0.75], "obstacle_x": [np.nan, 4.0], "obstacle_y": [np.nan, 5.0],
        }
    )  # fmt: skip

    def test_targets_seen_often_enough_are_no_gaps(self):
        gaps = gaps_of(TARGETS, np.array([0, 1, 0, 0]), 1, {"c", "d"}, self.explained)
        assert [(gap["target"], gap["reason"]) for gap in gaps] == [
            ("a", NOT_CHOSEN),
            ("c", OUT_OF_SIGHT),
            ("d", f"{OUT_OF_SIGHT}: hidden"),
        ]

    def test_details_are_told_where_they_are_known(self):
        times_seen = np.array([0, 0, 1, 0])
        gaps = gaps_of(TARGETS, times_seen, 1, {"b", "d"}, self.explained)
        keys = ("nearest_m", "blocked_share", "obstacle_x", "obstacle_y")
        assert [[gap[key] for key in keys] for gap in gaps] == [
            [None, None, None, None],
            [80.5, 0.0, None, None],
            [12.5, 0.75, 4.0, 5.0],
        ]

    def test_more_than_one_sensor_asked_for(self):
        gaps = gaps_of(TARGETS, np.array([2, 1, 2, 2]), 2, set(), self.explained.iloc[:0])
        assert [(gap["target"], gap["seen"], gap["reason"]) for gap in gaps] == [("b", 1, TOO_FEW)]

    def test_obstacles_tell_unknown_heights(self):
        layer = gpd.GeoDataFrame(
            {
                "kind": ["object", "ground"], "target": "a", "candidate": "p1",
                "height_m": [2.5, np.nan], "targets": [9, 1], "sensors": 1, "sight_lines": [12, 1],
            },
            geometry=gpd.points_from_xy([1, 2], [3, 4], [5, 6]),
        )  # fmt: skip
        first, second = obstacles_of(layer)
        assert (first["x"], first["y"], first["height_m"], first["targets"]) == (1, 3, 2.5, 9)
        assert second["height_m"] is None
        assert obstacles_of(layer.iloc[:0]) == []


class TestProofs:
    @pytest.mark.parametrize(
        ("status", "objective", "bound", "whole", "proven"),
        [
            ("optimal", 7.0, 7.0, True, True), ("optimal", 7.0, 6.001, True, True),
            ("optimal", 7.0, 6.0, True, False), ("optimal", 7.0, 6.001, False, False),
            ("optimal", 7.0, 7.0 - 1e-9, False, True), ("optimal", 7.0, 6.0 + 1e-9, True, False),
            ("time_limit", 7.0, 7.0, True, False), ("optimal", 0.0, 0.0, True, True),
        ],
    )  # fmt: skip
    def test_status_and_bound_must_agree(self, status, objective, bound, whole, proven):
        assert is_proven(status, objective, bound, whole) is proven

    def plan(self, title, **changes):
        plan = {"proven": True, "objective": 7.0, "bound": 7.0, "targets": 200, "at_least": 1}
        return plan | {"title": title, "gaps": []} | changes

    def test_sound_plans_need_no_caution(self):
        assert plan_cautions([self.plan("A"), self.plan("B")]) == []

    def test_what_stages_told_is_a_caution(self):
        told = {"code": "few_matches", "severity": "doubt", "measured": 0.5, "limit": 0.8}
        found = told_cautions([told | {"message": "only 1 of 2 zones lie at the site"}])
        assert found == (["Only 1 of 2 zones lie at the site: 0.5 (limit 0.8)."], [])

    def test_unproven_plan_tells_its_bounds(self):
        (caution,) = plan_cautions([self.plan("A", proven=False, bound=5.5)])
        assert "costs 7" in caution
        assert "5.5" in caution

    def test_what_holds_for_all_plans_is_said_once(self):
        (caution,) = plan_cautions([self.plan("A", gaps=[0] * 3), self.plan("B", gaps=[0] * 3)])
        assert caution.startswith("All plans: no sensor sees 3 targets (1.5")

    def test_what_holds_for_some_plans_names_them(self):
        plans = [self.plan("A", gaps=[0]), self.plan("B"), self.plan("C", gaps=[0])]
        (caution,) = plan_cautions(plans)
        assert caution.startswith("A, C: no sensor sees 1 target (")


TRAFFIC = {"points": 400, "cleared_points": 100, "clear_below_m": 4.5}
SETTINGS = {"targets": {"cell_size_m": 1.0, "min_points": 25}}


class TestData:
    @pytest.mark.parametrize("data", [(2000, 90, 2050.0), (None, None, 2050.0), (500, 50, 0.0)])
    def test_enough_data_or_no_placement_or_area_needs_no_caution(self, data):
        assert data_cautions(*data, SETTINGS) == []

    def test_each_shortage_is_named(self):
        few = data_cautions(40, 3, 400.0, SETTINGS)
        texts = " ".join(few)
        assert "Only 40 targets" in texts
        assert "Only 3 candidate positions" in texts
        assert "90" in texts
        assert "hatched on the map" in texts
        assert not data_cautions(500, 50, 2000.0, SETTINGS, 1990.0)
        (thin,) = data_cautions(500, 50, 2000.0, SETTINGS, 940.0)
        assert "53" in thin

    def test_scene_notes_are_sentences(self):
        frame = {"crs_wkt": None, "notes": ["z assumed to be in feet"]}
        sensors = {"A": {"cost": 1.0}, "B": {"cost": 1.0}}
        notes = scene_cautions(frame, False, TRAFFIC, {"automatic"}, sensors)
        assert len(notes) == 6
        assert "of the points were taken for passing vehicles" in notes[4]
        assert notes[0] == "Z assumed to be in feet."

    def test_well_known_scene_needs_no_note(self):
        frame = {"crs_wkt": "PROJCRS[]", "notes": []}
        sensors = {"A": {"cost": 1.0}, "B": {"cost": 3.0}}
        assert scene_cautions(frame, True, None, {"digitised"}, sensors) == []


class TestObjects:
    def test_each_object_says_what_was_saved_without_it_if_that_was_tried(self):
        objects = [{"name": n, "kind": "tree", "targets": 9, "sensors": 2} for n in ("one", "two")]
        saved = {"sensors": 4, "sensors_before": 5, "more_targets": 0, "kind": "sign"}
        removals = [{"object": n, "hidden_targets": 3, **saved} for n in ("two", "three")]
        one, two, three = objects_in_the_way(objects, removals)
        assert (one["without"], two["without"], three["without"]) == (None, *removals)
        assert (two["sensors"], three["sensors"], three["targets"]) == (2, None, 3)


def test_what_stages_told_is_said_once():
    told = {"measured": 0.4, "limit": 0.9}
    doubts = [
        {"code": "noisy_ground", "severity": "doubt", "message": "noisy ground"},
        {"code": "few_targets", "severity": "doubt", "message": "the page says this itself"},
    ]
    warnings, notes = told_cautions([doubt | told for doubt in doubts])
    assert page_cautions(warnings, notes) == [
        {"level": "warning", "text": "Noisy ground: 0.4 (limit 0.9)."}
    ]


@pytest.mark.parametrize(
    ("message", "measured", "limit", "told"),
    [
        ("share of filled cells of the DEM", 0.1491, None, "14.9\u202f%"),
        ("share of the outline without a step", 0.5, 0.25, "50\u202f% (limit 25\u202f%)"),
        ("pavement for each sensor, m2", 63.0, 100.0, "63 (limit 100)"),
        ("the share is unknown", "none", 0.5, "none (limit 50\u202f%)"),
    ],
)
def test_shares_are_told_as_percentages(message, measured, limit, told):
    doubt = {"code": "a", "severity": "note", "message": message}
    found = told_cautions([doubt | {"measured": measured, "limit": limit}])
    assert found == ([], [f"{message[:1].upper()}{message[1:]}: {told}."])
