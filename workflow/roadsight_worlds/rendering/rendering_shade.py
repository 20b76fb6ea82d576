"""Colours of surfaces and of the sky: procedural, in world coordinates, blue-green-red, linear."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Bytes, Floats, Floats32
from roadsight.base.kernels import compiled
from roadsight_worlds.casting.kernel import kernel
from roadsight_worlds.rendering.rendering_noise import (
    Colour,
    bump,
    fine2,
    hashed,
    mix,
    noise2,
    scaled,
)
from roadsight_worlds.rural.rural_markings import line_cover
from roadsight_worlds.rural.rural_materials import (
    PIXEL_OF_GROUND,
    PIXEL_OF_MATERIAL,
    Ground,
    Material,
)
from roadsight_worlds.rural.rural_surface import Surface, ground_kind

# Plain numbers, as compiled code takes them.
_GRASS, _SHOULDER, _ROAD, _SIDE, _GRAVEL, _, _WHITE, _YELLOW, _BRIDGE = map(int, Ground)
_GROUND, _FAR = int(Material.GROUND), int(Material.FAR_FOREST)
_LEAVES, _BUSH = int(Material.LEAVES), int(Material.BUSH)
_WOOD, _BARK = int(Material.POLE_WOOD), int(Material.BARK)
_WALL, _ROOF = int(Material.WALL), int(Material.ROOF)
_PAINT, _SIGN = int(Material.PAINT), int(Material.SIGN_PAINT)
_SKY = 9  # `PixelClass.SKY`.
_PLAIN = np.zeros((len(Material), 3))
for _material, _bgr in {
    Material.WIRE: (0.03, 0.03, 0.03),
    Material.STEEL_POST: (0.33, 0.33, 0.31),
    Material.FENCE: (0.16, 0.2, 0.24),
    Material.SIGN_YELLOW: (0.02, 0.5, 0.8),
    Material.SIGN_WHITE: (0.8, 0.8, 0.8),
    Material.SIGN_RED: (0.05, 0.04, 0.55),
    Material.SIGN_BLACK: (0.02, 0.02, 0.02),
    Material.SIGN_BACK: (0.4, 0.4, 0.39),
    Material.SIGN_GREEN: (0.13, 0.3, 0.02),
    Material.WINDOW: (0.1, 0.08, 0.06),
    Material.GLASS: (0.06, 0.05, 0.04),
    Material.TYRE: (0.02, 0.02, 0.02),
    Material.RAIL: (0.46, 0.46, 0.45),
    Material.CONCRETE: (0.4, 0.43, 0.45),
    Material.FITTING: (0.3, 0.28, 0.26),
    Material.DELINEATOR: (0.75, 0.78, 0.8),
}.items():
    _PLAIN[_material] = _bgr
# Colours of vehicles: blue, green, red.
_PAINTS = np.array(
    [[0.5, 0.5, 0.5], [0.03, 0.03, 0.4], [0.3, 0.12, 0.03], [0.02, 0.02, 0.02], [0.7, 0.7, 0.7]]
)
# Colours of walls: blue, green, red.
_WALLS = np.array([[0.62, 0.66, 0.68], [0.35, 0.5, 0.6], [0.5, 0.42, 0.35], [0.12, 0.16, 0.38]])
# Colours of signs: yellow, white, red, green, blue, orange, brown, lime, grey, black.
_SIGNS = np.array(
    [
        [0.02, 0.5, 0.8],
        [0.8, 0.8, 0.8],
        [0.05, 0.04, 0.55],
        [0.13, 0.3, 0.02],
        [0.45, 0.16, 0.02],
        [0.02, 0.25, 0.75],
        [0.04, 0.1, 0.2],
        [0.05, 0.75, 0.6],
        [0.4, 0.4, 0.39],
        [0.02, 0.02, 0.02],
    ]
)


class Look(NamedTuple):
    """Weather and season of one image; colours are blue, green, red.

    Parameters
    ----------
    sun : unit vector to the sun (x, y, z). sun_light, sky_light : (3,) strength of each.
    haze_m : distance at which two thirds are haze. horizon, zenith : colours of the sky.
    cloud : share of cloud. seed : of the textures. lush : 0 dry grass to 1 green.
    asphalt : how bright asphalt is. wear : how worn markings are.
    """

    sun: Floats
    sun_light: Floats
    sky_light: Floats
    haze_m: float
    horizon: Floats
    zenith: Floats
    cloud: float
    seed: int
    lush: float
    asphalt: float
    wear: float


class Hits(NamedTuple):
    """First surfaces along rays, row by row.

    Parameters
    ----------
    place : (n, 3) local metres. ray : (n, 3) unit. depth : (n,) along the ray, inf for sky.
    material : (n,) uint8. tint : (n,). normal : (n, 3). road : (n, 2) station and offset, of the
    corridor's ground only. lit : (n,) share of the sun that arrives. pixel_rad : width of a pixel.
    """

    place: Floats
    ray: Floats
    depth: Floats
    material: Bytes
    tint: Floats32
    normal: Floats32
    road: Floats
    lit: Floats32
    pixel_rad: float


@kernel
def _asphalt(look: Look, s: float, o: float, fine: float, side: bool) -> Colour:
    """Grain, tyre tracks, repair patches, cracks."""
    k = look.seed
    grey = look.asphalt * (1.25 if side else 1.0)
    grey *= 1.0 + 0.22 * fine2(s, o, 0.025, fine, k) + 0.1 * fine2(s, o, 0.11, fine, k + 1)
    grey *= 1.0 + 0.1 * noise2(s / 6.0, o / 1.3, k + 2) + 0.06 * noise2(s / 25.0, o / 3.0, k + 3)
    if not side:
        lane = abs(o) - 1.6
        tracks = bump(lane, 0.85, 0.3) + bump(lane, -0.85, 0.3)
        grey *= 1.0 - 0.1 * tracks + 0.05 * bump(lane, 0.0, 0.35)
        cell = math.floor(s / 13.0)
        if hashed(int(cell), 5, k) < 0.17:
            begin, length = 13.0 * cell + 2.0, 2.0 + 8.0 * hashed(int(cell), 6, k)
            wide = hashed(int(cell), 7, k)
            if begin < s < begin + length and wide < 0.75 and o * (wide - 0.375) > 0.0:
                grey *= 0.72
    crack = abs(noise2(s / 2.3 + 0.4 * noise2(s, o, k + 4), o / 1.1, k + 5))
    reach = 0.012 + 0.35 * fine
    if crack < reach and noise2(s / 19.0, o / 5.0, k + 6) > 0.3:
        grey *= 1.0 - 0.3 * min(0.012 / reach * 2.0, 1.0)
    return grey * 1.02, grey, grey * 0.97


@kernel
def _gravel(look: Look, x: float, y: float, fine: float) -> Colour:
    """Stones of two sizes with some dust and weeds."""
    k = look.seed + 20
    light = 0.34 * (1.0 + 0.3 * fine2(x, y, 0.04, fine, k) + 0.15 * fine2(x, y, 0.2, fine, k + 1))
    light *= 1.0 + 0.12 * noise2(x / 3.0, y / 3.0, k + 2)
    weeds = 0.5 * max(noise2(x / 1.1, y / 1.1, k + 3) - 0.25, 0.0)
    return mix((light * 0.78, light * 0.92, light), (0.05, 0.2, 0.16), weeds)


@kernel
def _grass(look: Look, x: float, y: float, away: float, fine: float) -> Colour:
    """Blades, tufts, patches of other green and straw; darker litter under the woods."""
    k = look.seed + 40
    tuft = fine2(x, y, 0.06, fine, k) * 0.4 + fine2(x, y, 0.23, fine, k + 1) * 0.34
    tuft += fine2(x, y, 0.7, fine, k + 8) * 0.2
    tuft += noise2(x / 1.6, y / 1.6, k + 2) * 0.16 + noise2(x / 7.0, y / 7.0, k + 3) * 0.16
    dry = min(max(0.75 - look.lush + 0.35 * noise2(x / 4.0, y / 4.0, k + 4), 0.0), 1.0)
    colour = mix((0.045, 0.175, 0.115), (0.13, 0.29, 0.35), dry)
    if away < 7.4:
        soil = min(max(0.5 * noise2(x / 0.9, y / 0.9, k + 5) + 0.05, 0.0), 0.6)
        colour = mix(colour, (0.1, 0.16, 0.22), soil)
    shade = min(max((away - 14.0) / 20.0 + 0.5 * noise2(x / 15.0, y / 15.0, k + 6), 0.0), 0.55)
    colour = mix(colour, (0.04, 0.1, 0.1), shade)
    return scaled(colour, max(1.0 + 1.2 * tuft, 0.15))


@kernel
def _ground_colour(
    look: Look, surface: Surface, hits: Hits, i: int, fine: float, kind: int, blur: float
) -> Colour:
    """Ground at hit ``i``; ``blur`` is the pixel's width across the road."""
    x, y = hits.place[i, 0], hits.place[i, 1]
    s, o = hits.road[i, 0], hits.road[i, 1]
    away = abs(o)
    if kind in (_ROAD, _BRIDGE):
        colour = _asphalt(look, s, o, fine, False)
        if away > surface.pavement_m:
            colour = scaled((0.42, 0.44, 0.45), 1.0 + 0.1 * fine2(x, y, 0.3, fine, 3))
        if kind == _BRIDGE:
            colour = mix(colour, (0.4, 0.42, 0.43), 0.35)
        white, yellow = line_cover(surface.paint, s, o, blur)
        worn = look.wear * (0.45 + 0.8 * noise2(s / 3.0, o / 0.5, look.seed + 60))
        worn += 0.5 * look.wear * fine2(s, o, 0.05, fine, look.seed + 61)
        keep = min(max(1.0 - worn, 0.15), 1.0)
        colour = mix(colour, (0.72, 0.74, 0.74), white * keep)
        return mix(colour, (0.08, 0.42, 0.62), yellow * keep)
    if kind == _SHOULDER:
        grown = (away - surface.pavement_m) / (surface.shoulder_m - surface.pavement_m)
        grown += 0.55 * noise2(x / 0.7, y / 0.7, look.seed + 70)
        share = min(max((grown - 0.45) * 2.2, 0.0), 1.0)
        return mix(_gravel(look, x, y, fine), _grass(look, x, y, away, fine), share)
    if kind == _GRASS:
        return _grass(look, x, y, away, fine)
    if kind == _GRAVEL:
        return _gravel(look, x, y, fine)
    return _asphalt(look, x, y, fine, kind == _SIDE)


@kernel
def _thing_colour(look: Look, hits: Hits, i: int, fine: float) -> Colour:
    """Everything but the corridor's ground."""
    x, y, z = hits.place[i, 0], hits.place[i, 1], hits.place[i, 2]
    material, tint = hits.material[i], float(hits.tint[i])
    k = look.seed + 80
    if material in (_LEAVES, _BUSH, _FAR):
        base = mix((0.025, 0.13, 0.06), (0.05, 0.24, 0.16), tint)
        base = mix(base, (0.05, 0.2, 0.28), 0.5 * max(0.6 - look.lush, 0.0) * tint)
        spots = 0.4 * fine2(x + z, y - z, 0.05, fine, k) + 0.25 * fine2(x - z, y + z, 0.3, fine, k)
        if material == _FAR:
            spots += 0.4 * fine2(x + z, y - z, 3.0, fine, k) + 0.3 * fine2(x, y + z, 9.0, fine, k)
        return scaled(base, max(1.0 + spots, 0.2))
    if material in (_WOOD, _BARK):
        around = 9.0 * (x + y)
        grain = 0.35 * fine2(around, z / 0.6, 0.12, 9.0 * fine, k) + 0.12 * noise2(x + y, z, k)
        base = mix((0.1, 0.14, 0.19), (0.2, 0.24, 0.27), tint)
        return scaled(base, max(1.0 + grain, 0.3) * (1.0 if material == _WOOD else 0.75))
    if material in (_PAINT, _SIGN):
        colours = _PAINTS if material == _PAINT else _SIGNS
        row = min(int(tint * len(colours)), len(colours) - 1)
        return colours[row, 0], colours[row, 1], colours[row, 2]
    if material == _WALL:
        row = min(int(tint * 5.0), 3)
        board = 0.9 if (z / 0.18) % 1.0 < 0.12 else 1.0
        return _WALLS[row, 0] * board, _WALLS[row, 1] * board, _WALLS[row, 2] * board
    if material == _ROOF:
        tile = 1.0 + 0.15 * fine2(x + y, z, 0.25, fine, k)
        return scaled(mix((0.12, 0.12, 0.13), (0.08, 0.1, 0.22), tint), tile)
    wear = 1.0 + 0.08 * fine2(x + y, z, 0.1, fine, k)
    return scaled((_PLAIN[material, 0], _PLAIN[material, 1], _PLAIN[material, 2]), wear)


@kernel
def _sky(look: Look, dx: float, dy: float, dz: float) -> Colour:
    """Gradient with flat clouds, and the glow around the sun."""
    up = max(dz, 0.0)
    share = 1.0 - math.exp(-4.0 * up)
    horizon = look.horizon[0], look.horizon[1], look.horizon[2]
    colour = mix(horizon, (look.zenith[0], look.zenith[1], look.zenith[2]), share)
    x, y, k = dx / (up + 0.12), dy / (up + 0.12), look.seed + 100
    puff = 0.5 * noise2(0.9 * x, 0.9 * y, k) + 0.3 * noise2(2.1 * x, 2.1 * y, k + 1)
    puff += 0.16 * noise2(4.7 * x, 4.7 * y, k + 2) + 0.1 * noise2(10.0 * x, 10.0 * y, k + 3)
    cover = min(max((puff + 2.0 * look.cloud - 1.0) * 2.2, 0.0), 1.0) * min(6.0 * up + 0.3, 1.0)
    bright = 0.95 - 0.22 * max(puff, 0.0)
    colour = mix(colour, (bright, bright * 0.99, bright * 0.98), cover)
    near_sun = max(dx * look.sun[0] + dy * look.sun[1] + dz * look.sun[2], 0.0)
    return mix(colour, (1.0, 1.0, 1.0), 0.6 * near_sun**24 * (1.0 - 0.6 * cover))


@kernel
def _light(look: Look, hits: Hits, i: int, base: Colour) -> Colour:
    """Sun and sky on a surface; leaves let some light through."""
    nx, ny, nz = hits.normal[i, 0], hits.normal[i, 1], hits.normal[i, 2]
    leafy = hits.material[i] == _LEAVES or hits.material[i] == _BUSH
    toward = nx * hits.ray[i, 0] + ny * hits.ray[i, 1] + nz * hits.ray[i, 2]
    flip = -1.0 if toward > 0.0 and not leafy else 1.0
    facing = flip * (nx * look.sun[0] + ny * look.sun[1] + nz * look.sun[2])
    direct = (0.3 + 0.7 * facing if facing > 0.0 else 0.3 * (1.0 + facing)) if leafy else facing
    direct = max(direct, 0.0) * hits.lit[i]
    open_sky = 0.62 + 0.38 * flip * nz
    if leafy:
        open_sky = 0.5 + 0.4 * nz
    return (
        base[0] * (direct * look.sun_light[0] + open_sky * look.sky_light[0]),
        base[1] * (direct * look.sun_light[1] + open_sky * look.sky_light[1]),
        base[2] * (direct * look.sun_light[2] + open_sky * look.sky_light[2]),
    )


@kernel
def _footprint(hits: Hits, i: int, along_x: float, along_y: float) -> tuple[float, float]:
    """Width of a pixel on the ground (geometric mean), and across a road in direction (x, y)."""
    dx, dy, dz = hits.ray[i, 0], hits.ray[i, 1], hits.ray[i, 2]
    pixel = hits.pixel_rad * hits.depth[i]
    level = max(math.hypot(dx, dy), 1e-9)
    stretched = pixel / max(abs(dz), 0.004)
    turn = abs(dx * along_y - dy * along_x) / level
    along = math.sqrt(max(1.0 - turn * turn, 0.0))
    return math.sqrt(pixel * stretched), pixel * along + stretched * turn


@compiled(error_model="numpy", nogil=True)
def shade(
    look: Look, surface: Surface, hits: Hits, road_cos: Floats, road_sin: Floats
) -> tuple[Floats32, Bytes]:
    """Linear colours (n, 3) and `PixelClass` (n,) of hits.

    Parameters
    ----------
    road_cos, road_sin : (n,) direction of the road at each hit of the ground.
    """
    count = len(hits.depth)
    colours, classes = np.empty((count, 3), np.float32), np.empty(count, np.uint8)
    for i in range(count):
        dx, dy, dz = hits.ray[i, 0], hits.ray[i, 1], hits.ray[i, 2]
        if not math.isfinite(hits.depth[i]):
            colours[i, 0], colours[i, 1], colours[i, 2] = _sky(look, dx, dy, dz)
            classes[i] = _SKY
            continue
        if hits.material[i] == _GROUND:
            s, o = hits.road[i, 0], hits.road[i, 1]
            kind = ground_kind(surface, hits.place[i, 0], hits.place[i, 1], s, o)
            fine, across = _footprint(hits, i, road_cos[i], road_sin[i])
            base = _ground_colour(look, surface, hits, i, fine, kind, across)
            if kind in (_ROAD, _BRIDGE):
                white, yellow = line_cover(surface.paint, s, o, 0.0)
                kind = _WHITE if white > 0.0 else _YELLOW if yellow > 0.0 else kind
            classes[i] = PIXEL_OF_GROUND[kind]
        else:
            base = _thing_colour(look, hits, i, hits.pixel_rad * hits.depth[i])
            classes[i] = PIXEL_OF_MATERIAL[hits.material[i]]
        lit = _light(look, hits, i, base)
        haze = 1.0 - math.exp(-((hits.depth[i] / look.haze_m) ** 1.2))
        horizon = look.horizon[0], look.horizon[1], look.horizon[2]
        colours[i, 0], colours[i, 1], colours[i, 2] = mix(lit, scaled(horizon, 0.9), haze)
    return colours, classes
