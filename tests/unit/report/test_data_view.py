from roadsight.report.site.plan_view import data_view

SENSOR = {
    "candidate": "a", "sensor": "OS-64", "along_road_m": 3.0, "points_per_s": 1e6,
    "pixels_per_s": 0.0, "road_points_per_s": 2e5,
}  # fmt: skip
DATA = {
    "share_seen_by_two": 0.5, "mean_sensors": 1.5, "mean_overlap_m": None, "points_per_s": 1e6,
    "road_points_per_s": 2e5, "pixels_per_s": 0.0, "sensors": [SENSOR],
}  # fmt: skip
HEIGHTS = [
    {
        "unit": "points",
        "bands": [
            {"from_m": 0.0, "to_m": 0.85, "mean": 4.0, "median": 3.0, "share_none": 0.25},
            {"from_m": 0.85, "to_m": 1.7, "mean": 8.0, "median": 7.5, "share_none": 0.0},
        ],
    }
]


def view(**more):
    return data_view({"data": DATA | more, "sensors": [{"candidate": "a", "number": 1}]})


def test_plans_without_a_curve_say_nothing_of_probabilities():
    for probability in (None, {"targets": 0}):
        found = view(probability=probability, heights=[])
        assert found["rows"][0][0] == "Targets seen by two sensors or more"
        assert found["heights"] == []


def test_a_second_objective_says_what_is_proven():
    second = {"once_more": 0.8, "once_more_before": 0.7, "once_more_bound": 0.9}
    second |= {"twice_more": 0.3, "shared_road_m": 210.0, "status": "time_limit"}
    plan = {"data": DATA, "sensors": [{"candidate": "a", "number": 1}], "second": second}
    rows = dict(data_view(plan)["rows"])
    assert rows["Targets seen once more than asked"].endswith("at most 90\u202f%")
    assert "proven" not in rows["Targets seen once more than asked"]
    plan["second"] = second | {"status": "optimal"}
    assert "proven" in dict(data_view(plan)["rows"])["Targets seen once more than asked"]


def test_probabilities_come_first():
    likely = {"targets": 9, "least": 0.904, "mean": 0.98, "independent": {"least": 0.96}}
    rows = view(probability=likely, heights=HEIGHTS)["rows"]
    assert [value for _, value in rows[:3]] == ["90.4\u202f%", "98\u202f%", "96\u202f%"]


def test_heights_are_a_chart_and_rows_from_the_top():
    (found,) = view(probability=None, heights=HEIGHTS)["heights"]
    assert found["rows"] == [
        ("0.85 to 1.70 m", "8.0", "7.5", "0\u202f%"),
        ("0.00 to 0.85 m", "4.0", "3.0", "25\u202f%"),
    ]
    assert found["chart"].count("<rect") == 2
    assert "Points on a target by height" in found["chart"]
