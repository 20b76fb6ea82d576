import pytest

from roadsight.placement.plans.plan_doubts import SAID, plan_doubts, target_doubts

SOLID = {
    "plan": "p", "status": "optimal", "objective": 4.0, "bound": 4.0, "uncoverable_targets": 0,
    "targets": 500, "sensors": [{}] * 4, "at_least": 1, "proven_area_m2": 480.0,
}  # fmt: skip


def test_nothing_is_told_of_solid_answers():
    assert target_doubts(500, 480.0, 500.0) == []
    assert target_doubts(500, 0.0, 0.0) == []
    assert plan_doubts(SOLID, 50) == []


def test_a_sensor_for_every_few_square_metres_is_told():
    (doubt,) = plan_doubts(SOLID | {"sensors": [{}] * 5}, 50)
    assert (doubt.code, doubt.measured, doubt.limit) == ("many_sensors", 96, 100)
    assert plan_doubts(SOLID | {"sensors": [{}] * 9, "at_least": 2}, 50) == []
    assert plan_doubts(SOLID | {"sensors": [], "proven_area_m2": 0.0}, 50) == []


def test_few_targets_and_pavement_without_any():
    few, thin = target_doubts(40, 40.0, 100.0)
    assert (few.code, few.measured, few.limit) == ("few_targets", 40, 100)
    assert (thin.code, thin.measured, thin.limit) == ("pavement_not_examined", 0.4, 0.9)


@pytest.mark.parametrize(
    ("change", "positions", "code", "measured", "limit"),
    [
        ({}, 3, "few_positions", 3, 10),
        ({"status": "time_limit", "bound": 3.0}, 50, "plan_not_proven", 4.0, 3.0),
        ({"uncoverable_targets": 7}, 50, "targets_not_seen", 7, 500),
    ],
)
def test_limits_of_a_plan(change, positions, code, measured, limit):
    (doubt,) = plan_doubts(SOLID | change, positions)
    assert (doubt.code, doubt.measured, doubt.limit) == (code, measured, limit)
    assert doubt.severity == "doubt"
    assert doubt.code in SAID
