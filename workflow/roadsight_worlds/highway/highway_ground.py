"""Ground of the sample highway: cross-section, slopes, roughness and the hill over the tunnel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats
from roadsight_worlds.casting.alignment import Alignment
from roadsight_worlds.casting.terrain import Terrain

_STATION_STEP_M = 0.4  # Nodes of the bumps along the road.
# Nodes of the bumps across the road, denser, so that those of the verge do not touch the pavement.
_OFFSET_STEP_M = 0.2
_COARSE_STEP_M = 3.0  # Nodes of the slow waves of the land beside the road.
_COARSE_SIGMA_M = 0.12  # Height of these waves, one sigma.
HALF_WIDTH_M = 45.0  # The ground ends so far to either side of the road.
# Top of the hill over the tunnel, above the road: above its ceiling, below the portal's top.
HILL_HEIGHT_M = 8.2
# Offset at which the portal's wings end; beyond them the hill begins further back and rises gently.
WING_M = 24.0


@dataclass(frozen=True)
class CrossSection:
    """Widths and heights across a divided highway, the same on both sides of the median.

    Parameters
    ----------
    median_half_m, median_rise_m : half the median strip and how far it stands above the pavement.
    inner_shoulder_m, lane_m, lanes, outer_shoulder_m : paved parts of one carriageway.
    cross_fall : fall of the pavement outwards.
    lip_m : drop from the pavement's outer edge to the verge.
    verge_m : unpaved verge outside the pavement.
    """

    median_half_m: float = 1.0
    median_rise_m: float = 0.12
    inner_shoulder_m: float = 0.75
    lane_m: float = 3.75
    lanes: int = 2
    outer_shoulder_m: float = 2.5
    cross_fall: float = 0.02
    lip_m: float = 0.04
    verge_m: float = 1.5

    @property
    def lane_edges_m(self) -> tuple[float, ...]:
        """Distance from the reference line of the marked lines, innermost first."""
        inner = self.median_half_m + self.inner_shoulder_m
        return tuple(inner + i * self.lane_m for i in range(self.lanes + 1))

    @property
    def pavement_m(self) -> tuple[float, float]:
        """Distance from the reference line of the pavement's inner and outer edge."""
        return self.median_half_m, self.lane_edges_m[-1] + self.outer_shoulder_m

    def profile(self) -> tuple[Floats, Floats]:
        """Break points of the ground across the road: offset and height above the grade plane.

        The left side rises as a cut behind a ditch, the right side falls as a fill.
        """
        inner, outer = self.pavement_m
        edge = -self.cross_fall * (outer - inner)
        verge = edge - self.lip_m, edge - self.lip_m - 0.06 * self.verge_m
        bench = outer + 0.1 + self.verge_m
        right = [(bench, verge[1]), (bench + 13.5, verge[1] - 4.5), (60.0, verge[1] - 5.1)]
        left = [
            (bench, verge[1]),
            (bench + 1.0, verge[1] - 0.45),
            (bench + 1.5, verge[1] - 0.45),
            (bench + 18.1, verge[1] + 7.85),
            (60.0, verge[1] + 9.0),
        ]
        kerb, lip = (inner - 0.05, self.median_rise_m), (outer + 0.1, verge[0])
        road = [kerb, (inner, 0.0), (outer, edge), lip]
        points = [(-x, z) for x, z in reversed(road + right)] + road + left
        offset, height = np.array(points).T
        return offset, height


def highway_terrain(
    alignment: Alignment,
    section: CrossSection,
    length_m: float,
    tunnel_start_m: float,
    height_m: float,
    grade: float,
    rng: np.random.Generator,
) -> Terrain:
    """Terrain of the sample between stations 0 and ``length_m``, 45 m to both sides."""
    station = np.arange(-2 * _STATION_STEP_M, length_m + 3 * _STATION_STEP_M, _STATION_STEP_M)
    offset = np.arange(
        -HALF_WIDTH_M - 2 * _OFFSET_STEP_M, HALF_WIDTH_M + 3 * _OFFSET_STEP_M, _OFFSET_STEP_M
    )
    profile_offset, profile_height = section.profile()
    inner, outer = section.pavement_m
    clear = 1.5 * _OFFSET_STEP_M  # reach of a node: rough nodes must not touch the pavement
    distance = np.abs(offset)
    slopes = outer + 0.1 + section.verge_m
    parts = [distance < inner - clear, distance < outer + clear, distance < slopes]
    # Next to none on pavement, centimetres beside it.
    rough = np.select(parts, [0.03, 0.0003, 0.07], 0.15)
    bumps = rng.uniform(-1.0, 1.0, (len(station), len(offset))) * rough
    bumps += _undulation(section, station, offset, rng)
    cover = HILL_HEIGHT_M - np.interp(offset, profile_offset, profile_height)
    # None of the hill over the road, all behind the portal.
    beyond = np.maximum(distance - WING_M + 1.0, 0.0)
    start, width = tunnel_start_m + 0.3 * beyond, 0.6 + 3.0 * beyond
    rise = np.clip((station[:, None] - start) / width, 0.0, 1.0)
    share = np.where(distance > outer + 1.25, rise * rise * (3.0 - 2.0 * rise), 0.0)
    hill = share * np.maximum(cover, 0.0)
    return Terrain(
        alignment,
        height_m,
        grade,
        profile_offset,
        profile_height,
        bumps + hill,
        float(station[0]),
        float(offset[0]),
        _STATION_STEP_M,
        _OFFSET_STEP_M,
        0.0,
        length_m,
        -HALF_WIDTH_M,
        HALF_WIDTH_M,
        0,
    )


def _undulation(
    section: CrossSection, station: Floats, offset: Floats, rng: np.random.Generator
) -> Floats:
    """Gentle unevenness over several metres: millimetres on the road, decimetres on the slopes."""
    shape = [int(np.ptp(axis) / _COARSE_STEP_M) + 2 for axis in (station, offset)]
    nodes = rng.normal(0.0, _COARSE_SIGMA_M, shape)
    at = np.meshgrid(
        (station - station[0]) / _COARSE_STEP_M,
        (offset - offset[0]) / _COARSE_STEP_M,
        indexing="ij",
    )
    waves = ndimage.map_coordinates(nodes, at, order=1, mode="nearest")
    slopes = section.pavement_m[1] + 0.1 + section.verge_m
    return waves * np.clip((np.abs(offset) - slopes) / 3.0, 0.025, 1.0)


def is_marking(section: CrossSection, station_m: ArrayLike, offset_m: ArrayLike) -> Bools:
    """Whether road points carry paint: solid at the outer lines, 6 m dashes between the lanes."""
    station, distance = np.asarray(station_m), np.abs(offset_m)
    painted = np.zeros(np.shape(station), dtype=bool)
    for line in section.lane_edges_m:
        solid = line in (section.lane_edges_m[0], section.lane_edges_m[-1])
        painted |= (np.abs(distance - line) <= 0.075) & (solid | (station % 15.0 < 6.0))
    return painted


def is_paved(section: CrossSection, offset_m: ArrayLike) -> Bools:
    """Whether road points lie on one of the two carriageways."""
    inner, outer = section.pavement_m
    distance = np.abs(offset_m)
    return (distance >= inner) & (distance <= outer)
