"""Set cover beside plain HiGHS on synthetic road corridors of the study's sizes.

Targets lie on a 1 m grid on the carriageway, candidates every 4 m on both edges (and the median of
the larger sites) at heights of 4 to 10 m. A candidate sees a target where enough beams of its
channels fall on it within range and no trunk stands between. Both solvers get the same gap.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import highspy
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bench_measure import measured, row
from roadsight.placement.cover import Cover, CoverProblem, solve_cover_problem

LENGTH_M = 250.0
RADIUS_M, HEIGHT_M, MIN_BEAMS = 0.25, 0.6, 8
AZIMUTH_STEP_DEG = 0.1
CURVE_RADIUS_M = 600.0
LIMIT_S = 120.0


@dataclass(frozen=True)
class Corridor:
    """A synthetic site: numbers of targets and candidates, channels, range, shape, seed."""

    targets: int
    candidates: int
    channels: int
    half_fov_deg: float
    range_m: float
    curved: bool
    seed: int = 1

    @property
    def name(self) -> str:
        """Short name."""
        shape = "curved" if self.curved else "straight"
        return f"{self.targets} x {self.candidates}, {self.channels} channels, {shape}"


SITES = (
    Corridor(2045, 956, 32, 22.5, 120.0, False),
    Corridor(2045, 956, 32, 22.5, 120.0, True),
    Corridor(2045, 956, 64, 22.5, 120.0, True),
    Corridor(6239, 1900, 32, 22.5, 120.0, False),
    Corridor(6239, 1900, 64, 22.5, 120.0, True),
    Corridor(8219, 2019, 32, 22.5, 120.0, True),
    Corridor(8219, 2019, 64, 22.5, 120.0, False),
)
QUICK = (Corridor(400, 160, 32, 22.5, 120.0, True),)


def detection_matrix(site: Corridor) -> sparse.csr_matrix:
    """Which candidate sees which target, (candidates, targets); unseen targets are left out."""
    rng = np.random.default_rng(site.seed)
    lanes = int(np.ceil(site.targets / LENGTH_M))
    along, across = np.meshgrid(np.arange(LENGTH_M) + 0.5, np.arange(lanes) + 0.5 - lanes / 2)
    targets = _plan(site, along.ravel(), across.ravel())
    targets = targets[np.sort(rng.permutation(len(targets))[: site.targets])]
    edge = lanes / 2 + 1
    offsets = [edge, -edge, 0.0] if site.candidates > 1_500 else [edge, -edge]
    grid = np.meshgrid(np.arange(0, LENGTH_M + 1, 4), offsets, np.arange(4, 10.1, 0.5))
    stations, sides, heights = (axis.ravel() for axis in grid)
    kept = np.sort(rng.permutation(len(stations))[: site.candidates])
    places, heights = _plan(site, stations[kept], sides[kept]), heights[kept]
    trunks = _plan(site, rng.uniform(0, LENGTH_M, 25), rng.choice([-edge, edge], 25))
    radii = rng.uniform(0.15, 0.4, 25)
    rows = [_seen(site, targets, place, height, trunks, radii)
            for place, height in zip(places, heights, strict=True)]  # fmt: skip
    seen = sparse.csr_matrix(np.array(rows))
    return seen[:, np.flatnonzero(np.diff(seen.tocsc().indptr))].tocsr()


def _plan(
    site: Corridor, along: NDArray[np.float64], across: NDArray[np.float64]
) -> NDArray[np.float64]:
    if not site.curved:
        return np.stack([along, across], axis=-1)
    angle, radius = along / CURVE_RADIUS_M, CURVE_RADIUS_M - across
    return np.stack([radius * np.sin(angle), CURVE_RADIUS_M - radius * np.cos(angle)], axis=-1)


def _seen(site, targets, place, height, trunks, radii) -> NDArray[np.bool_]:
    away = targets - place
    distance = np.hypot(*away.T)
    elevations = np.linspace(-site.half_fov_deg, site.half_fov_deg, site.channels)
    foot = np.degrees(np.arctan2(-height, distance - RADIUS_M))
    top = np.degrees(np.arctan2(HEIGHT_M - height, distance))
    channels = np.searchsorted(elevations, top, "right") - np.searchsorted(elevations, foot)
    columns = np.floor(2 * np.degrees(np.arctan2(RADIUS_M, distance)) / AZIMUTH_STEP_DEG)
    seen = (channels * columns > MIN_BEAMS) & (np.hypot(distance, height) <= site.range_m)
    for trunk, radius in zip(trunks - place, radii, strict=True):
        if np.hypot(*trunk) < 1:
            continue
        share = np.clip(away @ trunk / np.maximum(distance**2, 1e-9), 0, 1)
        seen &= np.hypot(*(trunk - share[:, None] * away).T) > radius
    return seen


def plain_highs(matrix: sparse.csr_matrix, limit_s: float) -> tuple[float, float]:
    """Objective and bound of the whole integer program, unit costs, absolute gap 0.999."""
    choices, targets = matrix.shape
    highs = highspy.Highs()
    settings = {"output_flag": False, "threads": 1, "random_seed": 1, "mip_abs_gap": 0.999,
                "mip_rel_gap": 0.0, "time_limit": limit_s}  # fmt: skip
    for name, value in settings.items():
        highs.setOptionValue(name, value)
    columns = np.arange(choices, dtype=np.int32)
    highs.addVars(choices, np.zeros(choices), np.ones(choices))
    highs.changeColsCost(choices, columns, np.ones(choices))
    highs.changeColsIntegrality(choices, columns, np.full(choices, highspy.HighsVarType.kInteger))
    rows = matrix.T.tocsr()
    highs.addRows(targets, np.ones(targets), np.full(targets, np.inf), rows.nnz,
                  rows.indptr[:-1], rows.indices, np.ones(rows.nnz))  # fmt: skip
    highs.run()
    info = highs.getInfo()
    return info.objective_function_value, info.mip_dual_bound


def compare(site: Corridor, limit_s: float) -> dict[str, Any]:
    """One row: both solvers on a site."""
    matrix = detection_matrix(site)
    cover, ours_s, ours_mib = measured(lambda: solve_cover_problem(CoverProblem(matrix), limit_s))
    (value, bound), theirs_s, theirs_mib = measured(lambda: plain_highs(matrix, limit_s))
    return row(
        "set cover with proof",
        ("row-generated relaxation, target-pair branching", ours_s, ours_mib),
        ("HiGHS (absolute gap 0.999)", theirs_s, theirs_mib),
        _agreement(cover, value, bound),
        site.name,
    )


def _agreement(cover: Cover, value: float, bound: float) -> tuple[float, str]:
    """1 where neither solver's proven bound contradicts the other's cover; both answers."""
    lifted = np.ceil(bound - 1e-6)
    consistent = lifted <= cover.objective and cover.bound <= value + 1e-6
    theirs = "optimal" if value - bound < 1 else "time_limit"
    ours = f"{cover.objective:g} [{cover.bound:g}] {cover.status}"
    return float(
        consistent
    ), f"bounds agree: ours {ours}, HiGHS {value:.0f} [{lifted:.0f}] {theirs}"


def rows(quick: bool) -> list[dict[str, Any]]:
    """Rows of the benchmark; ``quick`` takes one small corridor."""
    small = detection_matrix(QUICK[0])
    solve_cover_problem(CoverProblem(small))  # compiles
    return [compare(site, 20.0 if quick else LIMIT_S) for site in (QUICK if quick else SITES)]


def main() -> None:
    """Print a table and write the rows as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    table = rows(arguments.quick)
    for line in table:
        print(f"{line['workload']:36} {line['cpu_s_ours']:8.2f} s {line['cpu_s_against']:8.2f} s"
              f" ratio {line['ratio']:6.3g}  {line['agreement_metric']}")  # fmt: skip
    if arguments.out:
        arguments.out.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
