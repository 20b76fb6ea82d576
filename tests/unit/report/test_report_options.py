import pytest

from roadsight.report.site.options_view import goal_proven, goal_text, is_soft, options_view

ALTERNATIVES = {"replaceable": [2, 0], "by": [["p", "q"], []], "places": 2, "different": ["x", "y"]}


def plan(kind="cost", value=2.0, bound=2.0, asked=None, **rest):
    options = {
        "asked": asked or {}, "goal": {"kind": kind, "value": value, "bound": bound},
        "weight": {"seen": 75.0, "of": 100.0}, "failure": {"left_share": 0.5, "worst": "a"},
        "short": {}, "forbidden_candidates": 0, **rest,
    }  # fmt: skip
    sensors = [{"number": 1, "candidate": "a"}, {"number": 2, "candidate": "b"}]
    return {"options": options, "sensors": sensors}


@pytest.mark.parametrize(
    ("kind", "text", "soft"),
    [
        ("cost", "It costs 2; nothing that meets the same conditions costs under 1.", False),
        ("coverage", "It sees a weight of 2 of 100; nothing within the budget sees over 1.", True),
        ("cost and price", "Sensors and unseen targets cost 2 together; no choice", True),
    ],
)
def test_goal_is_one_sentence(kind, text, soft):
    found = plan(kind, bound=1.0)
    assert goal_text(found["options"]).startswith(text)
    assert is_soft(found) == soft


def test_proven_needs_status_and_bound():
    assert goal_proven({"value": 5.0, "bound": 5.0}, "optimal")
    assert not goal_proven({"value": 5.0, "bound": 6.0}, "optimal")
    assert not goal_proven({"value": 5.0, "bound": 5.0}, "time_limit")


def test_a_plan_without_options_has_no_view():
    assert options_view({"sensors": []}) is None
    assert not is_soft({"sensors": []})


def test_only_what_is_asked_has_a_row():
    asked = {"budget": {"sensors": 4, "cost": None}, "spacing_m": 12.0, "keep_share": 0.4}
    rows = options_view(plan("coverage", asked=asked))["rows"]
    assert [row[:2] for row in rows] == [
        ("Budget", "4 sensors"),
        ("Distance of sensors, at least", "12 m"),
        ("Coverage that any one failure leaves", "40\u202f%"),
    ]
    assert rows[0][2] == "75\u202f% of the weight seen"
    assert options_view(plan())["rows"] == [
        ("One sensor fails", "", "50\u202f% left when the worst sensor fails")
    ]


def test_curve_has_a_dot_and_a_row_for_each_budget():
    points = [
        {"budget": b, "spent": b, "sensors": b, "weight": w, "bound": u, "status": s}
        for b, w, u, s in [(1, 50.0, 50.0, "optimal"), (2, 75.0, 90.0, "time_limit")]
    ]
    found = options_view(plan(curve={"of": "sensors", "total": 100.0, "points": points}))
    assert found["curve"].count("<circle") == 2
    assert ">Sensors<" in found["curve"]
    shown = [(p["share"], p["bound_share"], p["added"], p["proven"]) for p in found["points"]]
    assert shown == [(0.5, 0.5, 0.5, True), (0.75, 0.9, 0.25, False)]


@pytest.mark.parametrize(
    ("shared", "least", "text"),
    [
        (2, 2, "Every answer that is no dearer and sees no less stands at the same places."),
        (1, 1, "1 sensor elsewhere and 1 at the same places. None shares fewer: that is proven."),
        (1, 0, "proves only that 0 must be shared."),
        (2, 0, "No such answer was found that stands elsewhere."),
    ],
)
def test_uniqueness_says_what_is_proven(shared, least, text):
    asked = ALTERNATIVES | {"shared_places": shared, "least_shared_places": least}
    found = options_view(plan(alternatives=asked))["alternatives"]
    assert text in found["text"]
    assert [(row["count"], row["by"]) for row in found["rows"]] == [(2, "p, q"), (0, "")]
