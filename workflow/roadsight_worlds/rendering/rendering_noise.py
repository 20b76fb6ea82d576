"""Noise without tables, hashed from whole coordinates, and arithmetic of colours."""

from __future__ import annotations

import math

from roadsight_worlds.casting.kernel import kernel

Colour = tuple[float, float, float]
_MASK = 0xFFFFFFFF  # Keeps whole numbers at 32 bits.


@kernel
def hashed(i: int, j: int, k: int) -> float:
    """Number in [0, 1) of three whole numbers."""
    h = (i * 0x1E3779B1 + k * 0x42B2AE35) & _MASK
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & _MASK
    h = (h + j * 0x25EBCA6B) & _MASK
    h = ((h ^ (h >> 13)) * 0x297A2D39) & _MASK
    h ^= h >> 15
    return (h & 0xFFFFFF) / 16777216.0


@kernel
def noise2(x: float, y: float, seed: int) -> float:
    """Smooth noise in [-1, 1] with features one unit wide."""
    i, j = math.floor(x), math.floor(y)
    f, g = x - i, y - j
    f, g = f * f * (3.0 - 2.0 * f), g * g * (3.0 - 2.0 * g)
    a, b = int(i), int(j)
    low = hashed(a, b, seed) * (1.0 - f) + hashed(a + 1, b, seed) * f
    high = hashed(a, b + 1, seed) * (1.0 - f) + hashed(a + 1, b + 1, seed) * f
    return 2.0 * (low * (1.0 - g) + high * g) - 1.0


@kernel
def fine2(x: float, y: float, cell: float, footprint: float, seed: int) -> float:
    """`noise2` with features of ``cell``, fading as a pixel's footprint grows beyond them."""
    fade = (cell * 1.6 - footprint) / cell
    if fade <= 0.0:
        return 0.0
    return min(fade, 1.0) * noise2(x / cell, y / cell, seed)


@kernel
def mix(a: Colour, b: Colour, share: float) -> Colour:
    """Colour between ``a`` (share 0) and ``b`` (share 1)."""
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


@kernel
def scaled(a: Colour, factor: float) -> Colour:
    """Colour times a factor."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@kernel
def bump(x: float, middle: float, width: float) -> float:
    """Bell of height 1."""
    return math.exp(-(((x - middle) / width) ** 2))
