"""What limits the worth of a plan: few targets, pavement without any, proofs that lack."""

from __future__ import annotations

from typing import Any

from roadsight.base.doubts import Doubt

FEW_TARGETS = 100  # with fewer, one target more or less can change the number of sensors
FEW_POSITIONS = 10  # the same of positions for sensors
# A smaller share of the pavement with targets is told: what is left out is wider than a kerb's
# strip of 0.2 m on each side of two lanes.
EXAMINED_SHARE = 0.9
# Less pavement for each sensor is told: 150 to 430 m2 on a generated highway and a street, with 16
# to 128 channels; 41 and 54 m2 at a junction where vehicles that passed had not been cleared.
LEAST_PER_SENSOR_M2 = 100.0
# Codes of doubts of which the report's pages say the same in their own words.
SAID = frozenset(
    {"few_targets", "few_positions", "pavement_not_examined", "plan_not_proven", "targets_not_seen"}
)


def target_doubts(targets: int, examined_m2: float, pavement_m2: float) -> list[Doubt]:
    """Doubts about the targets of a site.

    Parameters
    ----------
    targets : how many there are. examined_m2 : pavement that they stand for, of pavement_m2.
    """
    found = []
    if targets < FEW_TARGETS:
        text = "few targets: the number of sensors rests on little data"
        found.append(Doubt("few_targets", "doubt", text, targets, FEW_TARGETS))
    share = examined_m2 / pavement_m2 if pavement_m2 > 0 else 1.0
    if share < EXAMINED_SHARE:
        text = (
            "much of the pavement carries no target, because the cloud is thin there or it lies at"
            " the road's edge: a proof holds for the share that is examined"
        )
        found.append(Doubt("pavement_not_examined", "doubt", text, round(share, 3), EXAMINED_SHARE))
    return found


def plan_doubts(solution: dict[str, Any], positions: int) -> list[Doubt]:
    """Doubts about a plan.

    Parameters
    ----------
    solution : plan, status, objective, bound, sensors, at_least, proven_area_m2,
        uncoverable_targets and targets, as it is written.
    positions : at which its sensors may stand.
    """
    plan, found = solution["plan"], []
    if positions < FEW_POSITIONS:
        text = f"plan {plan} has few positions for sensors: there is little to choose from"
        found.append(Doubt("few_positions", "doubt", text, positions, FEW_POSITIONS))
    count = len(solution["sensors"])
    limit_m2 = LEAST_PER_SENSOR_M2 / solution["at_least"]
    area_m2 = solution.get("proven_area_m2")
    plain = "availability" not in solution and "options" not in solution
    if plain and count and area_m2 is not None and area_m2 / count < limit_m2:
        text = (
            f"plan {plan} takes many sensors: look on the map whether vehicles that passed stand on"
            " the pavement as walls (lidar.clear_below_m clears them), or whether it is no road."
            " Pavement for each sensor, m2"
        )
        each_m2 = round(area_m2 / count)
        found.append(Doubt("many_sensors", "doubt", text, each_m2, limit_m2))
    if solution["status"] != "optimal":
        text = f"plan {plan} is not proven optimal: its cost, and the least that is possible"
        found.append(
            Doubt("plan_not_proven", "doubt", text, solution["objective"], solution["bound"])
        )
    if solution["uncoverable_targets"]:
        text = f"plan {plan} leaves out targets that no sensor sees, of all targets"
        missing, of = solution["uncoverable_targets"], solution["targets"]
        found.append(Doubt("targets_not_seen", "doubt", text, missing, of))
    return found
