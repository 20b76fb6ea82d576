"""Exact casting of rays through a cell grid, nearest surface first."""

from __future__ import annotations

import math

import numpy as np

from roadsight.base.arrays import Floats, Ints32
from roadsight.base.kernels import compiled
from roadsight_worlds.casting.cellgrid import BLOCK, CellGrid
from roadsight_worlds.casting.kernel import kernel
from roadsight_worlds.casting.primitives import MIN_RANGE_M, Bodies, body_normal, ray_body
from roadsight_worlds.casting.terrain import Terrain, exists, surface_gradient, surface_height

_GROUND = -1  # Stands for the ground where other hits are numbers of bodies.
_NOTHING = -2  # Stands for no hit.
# Least step of the march above the ground, without which it would creep where a ray grazes; a
# shorter contact may be passed over.
_MIN_STEP_M = 2e-4
_ROOT_M = 1e-10  # Width of the interval at which the search for a crossing ends.
_ROOT_HEIGHT_M = 1e-12  # Clearance at which the search for a crossing ends.
Ray = tuple[float, float, float, float, float, float]


@kernel
def _clearance(terrain: Terrain, ray: Ray, t: float) -> float:
    """Height of the ray above the ground at range t."""
    ox, oy, oz, dx, dy, dz = ray
    return oz + t * dz - surface_height(terrain, ox + t * dx, oy + t * dy)


@kernel
def _root(terrain: Terrain, ray: Ray, a: float, fa: float, b: float, fb: float) -> float:
    """Range in [a, b] where the clearance changes sign: Illinois regula falsi, then bisection."""
    kept = 0
    t = a
    for step in range(80):
        if fa == 0.0 or b - a < _ROOT_M:
            return a
        t = a + (b - a) * fa / (fa - fb) if step < 30 else 0.5 * (a + b)
        ft = _clearance(terrain, ray, t)
        if abs(ft) < _ROOT_HEIGHT_M:
            return t
        if (ft >= 0.0) == (fa >= 0.0):
            a, fa = t, ft
            fb = 0.5 * fb if kept == 1 else fb
            kept = 1
        else:
            b, fb = t, ft
            fa = 0.5 * fa if kept == -1 else fa
            kept = -1
    return t


@kernel
def ground_range(
    terrain: Terrain, ray: Ray, start: float, end: float, slope: float, spread: float
) -> float:
    """First range in [start, end] where the ray crosses the ground, to 1e-9 m; infinity if none.

    Within the interval the ground rises along the ray by ``slope`` plus or minus ``spread`` per
    metre of range. So a step of clearance / closing speed never jumps a crossing. The march takes
    steps of at least 0.2 mm: a contact shorter than that along the ray may be passed over.
    """
    slowest, fastest = ray[5] - slope - spread, ray[5] - slope + spread
    t, f = start, _clearance(terrain, ray, start)
    while t < end:
        above = f >= 0.0
        closing = -slowest if above else fastest
        if closing <= 0.0:
            return math.inf
        monotone = slowest > 0.0 or fastest < 0.0
        ahead = end if monotone else min(end, t + max(_MIN_STEP_M, abs(f) / closing))
        g = _clearance(terrain, ray, ahead)
        if (g >= 0.0) != above:
            root = _root(terrain, ray, t, f, ahead, g)
            if exists(terrain, ray[0] + root * ray[3], ray[1] + root * ray[4]):
                return root
        t, f = ahead, g
    return math.inf


@kernel
def _clip(
    start: float, step: float, low: float, high: float, t: tuple[float, float]
) -> tuple[float, float]:
    """Part of the range interval ``t`` where ``low <= start + t step <= high``."""
    if step == 0.0:
        return t if low <= start <= high else (math.inf, -math.inf)
    a, b = (low - start) / step, (high - start) / step
    return max(t[0], min(a, b)), min(t[1], max(a, b))


@kernel
def _axis_walk(
    start: float, step: float, t: float, corner: float, cell: float, n: int
) -> tuple[int, int, float, float]:
    """Cell index at range t, its increment, range of its far border, range per cell."""
    index = min(max(int(math.floor((start + t * step - corner) / cell)), 0), n - 1)
    if step == 0.0:
        return index, 0, math.inf, math.inf
    border = corner + cell * (index + 1 if step > 0.0 else index)
    return index, (1 if step > 0.0 else -1), (border - start) / step, cell / abs(step)


@kernel
def _search_cell(
    bodies: Bodies,
    terrain: Terrain,
    grid: CellGrid,
    ray: Ray,
    span: tuple[float, float],
    at: tuple[int, int],
    found: tuple[float, int],
) -> tuple[float, int]:
    """Better of ``found`` and the first surface of the cell ``at`` (row, column)."""
    ox, oy, oz, dx, dy, dz = ray
    best, hit = found
    z_in, z_out = oz + span[0] * dz, oz + span[1] * dz
    lower, upper = min(z_in, z_out), max(z_in, z_out)
    if lower > grid.high_m[at] or upper < grid.low_m[at]:
        return best, hit
    cell = at[0] * grid.columns + at[1]
    for k in range(grid.first_body[cell], grid.first_body[cell + 1]):
        t = ray_body(bodies, grid.body[k], ox, oy, oz, dx, dy, dz)
        if t < best:
            best, hit = t, grid.body[k]
    ground = grid.ground
    if lower <= ground.high_m[at] and upper >= ground.low_m[at]:
        slope = dx * ground.slope_x[at] + dy * ground.slope_y[at]
        spread = ground.spread[at] * math.hypot(dx, dy)
        t = ground_range(terrain, ray, span[0], min(span[1], best), slope, spread)
        if t < best:
            best, hit = t, _GROUND
    return best, hit


@kernel
def _search_block(
    bodies: Bodies,
    terrain: Terrain,
    grid: CellGrid,
    ray: Ray,
    span: tuple[float, float],
    found: tuple[float, int],
) -> tuple[float, int]:
    """Better of ``found`` and the first surface in the cells along a span of ranges."""
    t, end = span
    column, right, next_x, per_x = _axis_walk(
        ray[0], ray[3], t, grid.x_m, grid.cell_m, grid.columns
    )
    row, up, next_y, per_y = _axis_walk(ray[1], ray[4], t, grid.y_m, grid.cell_m, grid.rows)
    while True:
        leave = max(t, min(next_x, next_y, end))
        found = _search_cell(bodies, terrain, grid, ray, (t, leave), (row, column), found)
        if found[0] <= leave or leave >= end:
            return found
        t = leave
        if next_x <= next_y:
            column, next_x = column + right, next_x + per_x
        else:
            row, next_y = row + up, next_y + per_y
        if not (0 <= row < grid.rows and 0 <= column < grid.columns):
            return found


@kernel
def nearest_hit(
    bodies: Bodies, terrain: Terrain, grid: CellGrid, ray: Ray, max_range: float
) -> tuple[float, int]:
    """Range and body number of the first surface (-1 is the ground, -2 nothing)."""
    ox, oy, oz, dx, dy, dz = ray
    span = _clip(oz, dz, grid.bottom_m, grid.top_m, (MIN_RANGE_M, max_range))
    span = _clip(ox, dx, grid.x_m, grid.x_m + grid.columns * grid.cell_m, span)
    t, end = _clip(oy, dy, grid.y_m, grid.y_m + grid.rows * grid.cell_m, span)
    found = math.inf, _NOTHING
    if t > end:
        return found
    width = BLOCK * grid.cell_m
    rows, columns = grid.block_low_m.shape
    column, right, next_x, per_x = _axis_walk(ox, dx, t, grid.x_m, width, columns)
    row, up, next_y, per_y = _axis_walk(oy, dy, t, grid.y_m, width, rows)
    while True:
        leave = max(t, min(next_x, next_y, end))
        z_in, z_out = oz + t * dz, oz + leave * dz
        clears = min(z_in, z_out) > grid.block_high_m[row, column]
        if not (clears or max(z_in, z_out) < grid.block_low_m[row, column]):
            found = _search_block(bodies, terrain, grid, ray, (t, leave), found)
        if found[0] <= leave or leave >= end:
            return found
        t = leave
        if next_x <= next_y:
            column, next_x = column + right, next_x + per_x
        else:
            row, next_y = row + up, next_y + per_y
        if not (0 <= row < rows and 0 <= column < columns):
            return found


@kernel
def _normal(
    bodies: Bodies, terrain: Terrain, ray: Ray, t: float, hit: int
) -> tuple[float, float, float]:
    """Unit normal at the hit, on the side that the ray comes from."""
    ox, oy, oz, dx, dy, dz = ray
    x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
    if hit == _GROUND:
        slope_x, slope_y = surface_gradient(terrain, x, y)
        nx, ny, nz = -slope_x, -slope_y, 1.0
    else:
        nx, ny, nz = body_normal(bodies, hit, x, y, z)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if nx * dx + ny * dy + nz * dz > 0.0:
        length = -length
    return nx / length, ny / length, nz / length


@compiled(error_model="numpy", nogil=True)
def cast_rays(
    bodies: Bodies,
    terrain: Terrain,
    grid: CellGrid,
    origins: Floats,
    directions: Floats,
    max_range: float,
) -> tuple[Floats, Ints32, Floats]:
    """Range (inf = none), object (-1 = none), normal (NaN = none) of each ray's first surface."""
    n = len(origins)
    ranges, objects, normals = np.empty(n), np.empty(n, dtype=np.int32), np.empty((n, 3))
    for i in range(n):
        ray = (
            origins[i, 0],
            origins[i, 1],
            origins[i, 2],
            directions[i, 0],
            directions[i, 1],
            directions[i, 2],
        )
        ranges[i], hit = nearest_hit(bodies, terrain, grid, ray, max_range)
        if ranges[i] > max_range:
            ranges[i] = math.inf
            objects[i] = -1
            normals[i, 0] = normals[i, 1] = normals[i, 2] = math.nan
            continue
        objects[i] = terrain.object_id if hit == _GROUND else bodies.object_id[hit]
        normal = _normal(bodies, terrain, ray, ranges[i], hit)
        normals[i, 0], normals[i, 1], normals[i, 2] = normal
    return ranges, objects, normals
