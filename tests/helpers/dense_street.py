"""A street of blocks with painted lines: its cloud, and photographs of it by ray casting.

Everything is exact: places without noise, pinholes without distortion, classes without errors.
"""

from dataclasses import dataclass

import numpy as np

from roadsight.geometry.cameras import cam_from_world
from roadsight.poles.alignment.dense import GivenLens
from roadsight.poles.alignment.visible import SceneCloud
from roadsight.poles.images.kinds import PixelClass

SIZE = (360, 1200)
LENS = GivenLens(690.0, 588.0, 176.0)
_HALF_ROAD_M = 4.0
_SKY = 210.0


@dataclass(frozen=True)
class Block:
    """Box with axes along the world's; low and high corner, brightness, class."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    grey: float
    kind: PixelClass

    def shown(self, xyz: np.ndarray) -> np.ndarray:
        """Brightness (n,) of places (n, 3) on it: a building has windows."""
        pane = ((xyz[:, 1] - self.low[1]) % 2.9 > 1.6) & (xyz[:, 2] % 2.8 > 1.2)
        dark = pane & (self.kind == PixelClass.BUILDING) & (xyz[:, 2] < self.high[2] - 0.3)
        return self.grey * np.where(dark, 0.4, 1.0)


class DenseStreet:
    """Street along +y, ground at 0, blocks and posts on both sides drawn by a seed."""

    def __init__(self, seed: int = 1, length_m: float = 110.0) -> None:
        random = np.random.default_rng(seed)
        self.length_m = length_m
        self.blocks: list[Block] = []
        for side in (-1, 1):
            y = -5.0
            while y < length_m:
                deep, gap = random.uniform(6, 14), random.uniform(1, 5)
                x0, x1 = sorted((side * random.uniform(7.5, 9.5), side * 16.0))
                grey, high = random.uniform(40, 200), random.uniform(2.5, 9)
                corners = (x0, y, 0.0), (x1, y + deep, high)
                self.blocks.append(Block(*corners, grey, PixelClass.BUILDING))
                y += deep + gap
            for y in np.arange(random.uniform(4, 9), length_m, random.uniform(9, 14)):
                x = side * random.uniform(4.6, 6.5)
                corners = (x - 0.12, y - 0.12, 0.0), (x + 0.12, y + 0.12, random.uniform(3, 6))
                self.blocks.append(Block(*corners, random.uniform(20, 90), PixelClass.POLE))
            for y in np.arange(random.uniform(8, 16), length_m, random.uniform(17, 25)):
                x0, x1 = sorted((side * 2.6, side * 3.9))
                corners = (x0, y, 0.0), (x1, y + 4.2, 1.45)
                self.blocks.append(Block(*corners, random.uniform(30, 220), PixelClass.VEHICLE))

    def ground(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Brightness and class of places on the ground."""
        on_road = np.abs(x) < _HALF_ROAD_M
        line = (np.abs(np.abs(x) - 3.7) < 0.08) | ((np.abs(x) < 0.08) & (y % 9 < 4))
        kind = np.where(on_road, PixelClass.ROAD, PixelClass.OTHER)
        kind = np.where(line, PixelClass.MARKING, kind)
        grey = np.where(line, 235.0, np.where(on_road, 80.0, 70.0))
        return grey, kind

    def cloud(self, step_m: float = 0.12, seed: int = 0) -> SceneCloud:
        """Points of all surfaces with their brightness as intensity; the ground is at 0."""
        xyz, intensity = self.points(step_m, seed)
        return SceneCloud.of(xyz, intensity, np.zeros(len(xyz)))

    def points(self, step_m: float = 0.12, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 3) and intensities (n,) on all surfaces."""
        random = np.random.default_rng(seed)
        count = int(32 * self.length_m / step_m**2)
        x, y = random.uniform(-16, 16, count), random.uniform(-5, self.length_m, count)
        parts = [np.column_stack([x, y, np.zeros(count)])]
        levels = [self.ground(x, y)[0]]
        for block in self.blocks:
            low, high = np.array(block.low), np.array(block.high)
            for axis in range(3):
                for at in (low[axis], high[axis]) if axis < 2 else (high[2],):
                    others = [k for k in range(3) if k != axis]
                    area = np.prod((high - low)[others])
                    n = int(area / step_m**2) + 4
                    own = random.uniform(low, high, (n, 3))
                    own[:, axis] = at
                    parts.append(own)
                    levels.append(block.shown(own))
        xyz, level = np.concatenate(parts), np.concatenate(levels)
        inside = np.zeros(len(xyz), bool)
        for block in self.blocks:
            inside |= (xyz > np.array(block.low) + 1e-9).all(1) & (
                xyz < np.array(block.high) - 1e-9
            ).all(1)
            flat = (xyz[:, 2] == 0) & (xyz[:, :2] > block.low[:2]).all(1)
            inside |= flat & (xyz[:, :2] < block.high[:2]).all(1)
        # Real returns of one surface scatter by about a tenth of their range.
        noisy = np.maximum(level + random.normal(0.0, 8.0, len(level)), 0.0)
        return xyz[~inside], noisy[~inside]

    def photograph(
        self, pose: np.ndarray, lens: GivenLens = LENS, shape: tuple[int, int] = SIZE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Grey image and classes (rows, columns) from a pose x, y, z, heading, pitch, roll."""
        rows, columns = np.indices(shape)
        rays = np.stack(
            [
                (columns - lens.cx_px) / lens.focal_px,
                (rows - lens.cy_px) / lens.focal_px,
                np.ones(shape),
            ],
            axis=-1,
        )
        rays = rays @ cam_from_world(*pose[3:])
        grey, kind = np.full(shape, _SKY), np.full(shape, int(PixelClass.SKY))
        nearest = np.full(shape, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            down = np.where(rays[..., 2] < 0, -pose[2] / rays[..., 2], np.inf)
            x, y = (pose[k] + down * rays[..., k] for k in (0, 1))
            seen = (down < 150) & (np.abs(x) < 40)
            level, classes = self.ground(x, y)
            grey[seen], kind[seen], nearest[seen] = level[seen], classes[seen], down[seen]
            for block in self.blocks:
                first = (np.array(block.low) - pose[:3]) / rays
                second = (np.array(block.high) - pose[:3]) / rays
                near = np.minimum(first, second).max(axis=-1)
                far = np.maximum(first, second).min(axis=-1)
                hit = (near > 0.1) & (near < far) & (near < nearest)
                side = np.argmax(np.minimum(first, second)[hit], axis=-1)
                places = pose[:3] + near[hit, None] * rays[hit]
                grey[hit] = block.shown(places) * np.array([0.8, 1.0, 1.15])[side]
                kind[hit], nearest[hit] = int(block.kind), near[hit]
        return np.clip(grey, 0, 255).astype(np.uint8), kind.astype(np.uint8)
