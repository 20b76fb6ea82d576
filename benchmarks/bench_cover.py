"""Set cover beside plain HiGHS on synthetic road corridors of the study's sizes.

Targets lie on a 1 m grid on the carriageway, candidates every 4 m on both edges (and the median of
the larger sites) at heights of 4 to 10 m. A candidate sees a target where enough beams of its
channels fall on it within range and no trunk stands between. Both solvers get the same gap.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import highspy
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from bench_measure import Size, measured, row
from roadsight.io.records.matrices import read_element_list, read_set_list
from roadsight.setcover import Cover, CoverProblem, solve_cover_problem

RADIUS_M, HEIGHT_M, MIN_BEAMS = 0.25, 0.6, 8
AZIMUTH_STEP_DEG = 0.1
CURVE_RADIUS_M = 600.0
LIMIT_S = 120.0


@dataclass(frozen=True)
class Corridor:
    """A synthetic site: numbers of targets and candidates, channels, range, shape, seed, holes.

    ``holes`` is the share of detections that are lost at random: leaves, passers-by, poor returns.
    """

    targets: int
    candidates: int
    channels: int
    half_fov_deg: float
    range_m: float
    curved: bool
    seed: int = 1
    length_m: float = 250.0
    holes: float = 0.0

    @property
    def name(self) -> str:
        """Short name."""
        shape = "curved" if self.curved else "straight"
        lost = f", {self.holes:.0%} holes" if self.holes else ""
        return f"{self.targets} x {self.candidates}, {self.channels} channels, {shape}{lost}"


SITES = (
    Corridor(2045, 956, 32, 22.5, 120.0, False),
    Corridor(2045, 956, 32, 22.5, 120.0, True),
    Corridor(2045, 956, 64, 22.5, 120.0, True),
    Corridor(2045, 956, 128, 22.5, 120.0, True),
    Corridor(6239, 1900, 32, 22.5, 120.0, False),
    Corridor(6239, 1900, 64, 22.5, 120.0, True),
    Corridor(6239, 1900, 128, 22.5, 120.0, False),
    Corridor(8219, 2019, 32, 22.5, 120.0, True),
    Corridor(8219, 2019, 64, 22.5, 120.0, False),
    Corridor(8219, 2019, 128, 22.5, 120.0, True),
)
QUICK = Corridor(400, 160, 32, 22.5, 120.0, True)
HARDER = (
    Corridor(6239, 1900, 16, 15.0, 120.0, False),
    Corridor(2045, 956, 16, 15.0, 100.0, False, holes=0.2),
    Corridor(6239, 1900, 16, 15.0, 100.0, False, holes=0.2),
    Corridor(8219, 2019, 16, 15.0, 100.0, False, holes=0.2),
)
"""Rings of 16 channels with gaps between them, and detections lost at random."""
LARGE = Corridor(80_000, 20_000, 64, 22.5, 120.0, False, length_m=4_000.0)
PUBLIC = {
    "camera_placement_ac01.txt": 7,
    "sc_157_0.txt": 94_400,
    "sc_1000_11.txt": 146,
    "sc_330_0.txt": 27,
    "sc_5000_1.txt": 31,
}
"""Best values that are listed for the public instances."""


def detection_matrix(site: Corridor) -> sparse.csr_matrix:
    """Which candidate sees which target, (candidates, targets); unseen targets are left out."""
    rng = np.random.default_rng(site.seed)
    length_m = site.length_m
    lanes = int(np.ceil(site.targets / length_m))
    along, across = np.meshgrid(np.arange(length_m) + 0.5, np.arange(lanes) + 0.5 - lanes / 2)
    targets = _plan(site, along.ravel(), across.ravel())
    targets = targets[np.sort(rng.permutation(len(targets))[: site.targets])]
    edge = lanes / 2 + 1
    offsets = [edge, -edge, 0.0] if site.candidates > 1_500 else [edge, -edge]
    grid = np.meshgrid(np.arange(0, length_m + 1, 4), offsets, np.arange(4, 10.1, 0.5))
    stations, sides, heights = (axis.ravel() for axis in grid)
    kept = np.sort(rng.permutation(len(stations))[: site.candidates])
    places, heights = _plan(site, stations[kept], sides[kept]), heights[kept]
    trees = round(length_m / 10)
    trunks = _plan(site, rng.uniform(0, length_m, trees), rng.choice([-edge, edge], trees))
    radii = rng.uniform(0.15, 0.4, trees)
    rows = [sparse.csr_matrix(_seen(site, targets, place, height, trunks, radii))
            for place, height in zip(places, heights, strict=True)]  # fmt: skip
    seen = sparse.vstack(rows, format="csr")
    if site.holes:
        seen = _with_holes(seen, site.holes, rng)
    return seen[:, np.flatnonzero(np.diff(seen.tocsc().indptr))].tocsr()


def _with_holes(
    seen: sparse.csr_matrix, share: float, rng: np.random.Generator
) -> sparse.csr_matrix:
    kept = sparse.csr_matrix((rng.random(seen.nnz) >= share, seen.indices, seen.indptr), seen.shape)
    kept.eliminate_zeros()
    return kept


def _plan(
    site: Corridor, along: NDArray[np.float64], across: NDArray[np.float64]
) -> NDArray[np.float64]:
    if not site.curved:
        return np.stack([along, across], axis=-1)
    angle, radius = along / CURVE_RADIUS_M, CURVE_RADIUS_M - across
    return np.stack([radius * np.sin(angle), CURVE_RADIUS_M - radius * np.cos(angle)], axis=-1)


def _seen(site, targets, place, height, trunks, radii) -> NDArray[np.bool_]:
    seen = np.zeros(len(targets), bool)
    near = np.flatnonzero((np.abs(targets - place) <= site.range_m).all(axis=1))
    seen[near] = _seen_nearby(site, targets[near] - place, height, trunks - place, radii)
    return seen


def _seen_nearby(site, away, height, trunks, radii) -> NDArray[np.bool_]:
    distance = np.hypot(*away.T)
    elevations = np.linspace(-site.half_fov_deg, site.half_fov_deg, site.channels)
    foot = np.degrees(np.arctan2(-height, distance - RADIUS_M))
    top = np.degrees(np.arctan2(HEIGHT_M - height, distance))
    channels = np.searchsorted(elevations, top, "right") - np.searchsorted(elevations, foot)
    columns = np.floor(2 * np.degrees(np.arctan2(RADIUS_M, distance)) / AZIMUTH_STEP_DEG)
    seen = (channels * columns > MIN_BEAMS) & (np.hypot(distance, height) <= site.range_m)
    for trunk, radius in zip(trunks, radii, strict=True):
        if not 1 <= np.hypot(*trunk) <= site.range_m:
            continue
        share = np.clip(away @ trunk / np.maximum(distance**2, 1e-9), 0, 1)
        seen &= np.hypot(*(trunk - share[:, None] * away).T) > radius
    return seen


def plain_highs(
    matrix: sparse.csr_matrix, limit_s: float, costs: ArrayLike | None = None
) -> tuple[float, float]:
    """Objective and bound of the whole integer program, unit costs or given whole ones.

    The absolute gap is 0.999.
    """
    choices, targets = matrix.shape
    price = np.ones(choices) if costs is None else np.asarray(costs, np.float64)
    highs = highspy.Highs()
    settings = {"output_flag": False, "threads": 1, "random_seed": 1, "mip_abs_gap": 0.999,
                "mip_rel_gap": 0.0, "time_limit": limit_s}  # fmt: skip
    for name, value in settings.items():
        highs.setOptionValue(name, value)
    columns = np.arange(choices, dtype=np.int32)
    highs.addVars(choices, np.zeros(choices), np.ones(choices))
    highs.changeColsCost(choices, columns, price)
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


def rows(size: Size) -> list[dict[str, Any]]:
    """Rows of the benchmark: one small corridor, the study's sites, and all that is harder."""
    for site in (QUICK, SITES[1]):
        solve_cover_problem(CoverProblem(detection_matrix(site)))  # compiles
    if size == "quick":
        return [compare(QUICK, 20.0)]
    found = [compare(site, LIMIT_S) for site in SITES]
    if size == "usual":
        return found
    harder = [compare(site, 60.0) for site in HARDER]
    return [*found, *_public(), *harder, compare(LARGE, 300.0)]


def _public() -> list[dict[str, Any]]:
    """Public instances, where their folder is known."""
    folder = Path(os.environ.get("ROADSIGHT_DATA", "")) / "setcover"
    if not folder.is_dir():
        print("ROADSIGHT_DATA is not set: public instances are left out")
        return []
    return [_public_row(folder / name, best) for name, best in PUBLIC.items()]


def _public_row(path: Path, best: float) -> dict[str, Any]:
    """One public instance beside the best value that is listed for it."""
    elements = "camera" in path.name
    matrix, costs = (read_element_list(path), None) if elements else read_set_list(path)
    problem = CoverProblem(matrix, costs)
    cover, ours_s, ours_mib = measured(lambda: solve_cover_problem(problem, LIMIT_S))
    (value, bound), theirs_s, theirs_mib = measured(lambda: plain_highs(matrix, LIMIT_S, costs))
    return row(
        "set cover, public instance",
        ("row-generated relaxation, target-pair branching", ours_s, ours_mib),
        ("HiGHS", theirs_s, theirs_mib),
        (
            float(cover.objective <= best),
            f"at or below the listed {best:g}: ours {cover.objective:g} [{cover.bound:g}]"
            f" {cover.status}, HiGHS {value:g} [{bound:g}]",
        ),
        f"{path.stem}, {matrix.shape[1]} targets x {matrix.shape[0]} candidates",
    )


def main() -> None:
    """Print a table and write the rows as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", choices=("quick", "usual", "full"), default="usual")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    table = rows(arguments.size)
    for line in table:
        print(f"{line['workload']:36} {line['cpu_s_ours']:8.2f} s {line['cpu_s_against']:8.2f} s"
              f" ratio {line['ratio']:6.3g}  {line['agreement_metric']}")  # fmt: skip
    if arguments.out:
        arguments.out.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
