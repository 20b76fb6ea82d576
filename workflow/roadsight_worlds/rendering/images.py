"""Images of the rural site: colour, class and depth of every pixel by exact ray casting.

Depth and class belong to the ray through the pixel's centre. Colours are smoothed: markings by
their share of the pixel, thin things (poles, wires, signs) by four more rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32, Ints, Ints32, Numbers
from roadsight.base.kernels import compiled
from roadsight.geometry.cameras import Intrinsics
from roadsight.geometry.lens import RadialLens
from roadsight.geometry.ray_casting import FirstHits, RayScene
from roadsight_worlds.rendering.rendering_shade import Hits, Look, shade
from roadsight_worlds.rural.rural_materials import Material
from roadsight_worlds.rural.rural_road import RuralSite

# Shadows fall on what is nearer to the camera; what is further away counts as lit.
_SHADOW_REACH_M = 120.0
# Leaves further from the camera get `_FAR_LEAF_LIT` of the sun instead of a ray each.
_LEAF_SHADOW_REACH_M = 60.0
_FAR_LEAF_LIT = 0.8  # Less than all of the sun, because crowns shade themselves.
# Rays to the sun start so far off the surface, or they would meet it again in single precision.
_SHADOW_LIFT_M = 0.02
# Shifts, px, of four more rays in pixels at thin outlines, turned so that no two share a row or
# column.
_SUPER = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]])
# By `Material`, and last by nothing: what is often thinner than a pixel.
_THIN = np.array(
    [
        m.name.startswith(("SIGN_", "STEEL", "WIRE", "POLE", "FENCE", "RAIL", "DELIN", "FITTING"))
        for m in Material
    ]
    + [False]
)
_NOTHING = len(Material)
# By `Material`: what lets some of the sun through.
_LEAFY = np.isin(np.arange(len(Material)), (Material.LEAVES, Material.BUSH))


@dataclass(frozen=True)
class RenderedView:
    """One image with its truth.

    Parameters
    ----------
    colour : (h, w, 3) uint8 blue-green-red. classes : (h, w) uint8 `PixelClass`.
    depth_m : (h, w) float32 along the optical axis, infinite for the sky.
    """

    colour: Bytes
    classes: Bytes
    depth_m: Floats32

    def inverse_depth(self) -> NDArray[np.uint16]:
        """Relative inverse depth (h, w): 65535 is 1 m or nearer, 0 sky; larger is nearer."""
        return np.rint(65535.0 / np.maximum(self.depth_m, 1.0)).astype(np.uint16)


class Camera(NamedTuple):
    """Where an image is taken: intrinsics, rotation cam_from_world (3, 3), centre (3,)."""

    intrinsics: Intrinsics
    rotation: Floats
    position_m: Floats


class Cast(NamedTuple):
    """First surfaces along rays.

    Parameters
    ----------
    range_m : (n,) float64, infinity where nothing is met. triangle : (n,) int32, -1 for nothing.
    place_m : (n, 3). road_m : (n, 2) station and offset, 0 beyond the corridor's ground.
    """

    range_m: Floats
    triangle: Ints32
    place_m: Floats
    road_m: Floats

    def take(self, rows: Numbers) -> Cast:
        """The given rows."""
        return Cast(self.range_m[rows], self.triangle[rows], self.place_m[rows], self.road_m[rows])


class RuralRenderer:
    """A site that rays can be cast at; single-threaded, the same result every time."""

    def __init__(self, site: RuralSite) -> None:
        self.site = site
        mesh = site.mesh
        self._scene = RayScene(mesh.vertices_m, mesh.triangles)

    def cast(self, origins_m: ArrayLike, directions: ArrayLike) -> Cast:
        """First surface along each ray.

        Parameters
        ----------
        origins_m : (n, 3), or (3,) for rays from one point. directions : (n, 3) unit vectors.
        """
        found = self._scene.first_hits(origins_m, directions)
        origins = np.asarray(origins_m, float).reshape(-1, 3)
        road = self.site.mesh.triangles[: self.site.corridor_triangles], self.site.road_m
        reached = _reach(origins, np.asarray(directions, float), found, *road)
        return Cast(found.range_m.astype(float), found.triangle, *reached)

    def sunlit(self, cast: Cast, sun: Floats) -> Floats32:
        """Share of the sun that reaches each hit; far hits and the sky count as lit."""
        mesh = self.site.mesh
        lit, rows, start = _sun_rays(cast, mesh.normal, mesh.material, _LEAFY, sun)
        lit[rows] = ~self._scene.occluded(start, np.broadcast_to(sun, start.shape))
        return lit

    def _hits(self, cast: Cast, directions: Floats, lit: NDArray, pixel_rad: float) -> Hits:
        mesh, triangle = self.site.mesh, cast.triangle
        return Hits(
            cast.place_m,
            directions,
            cast.range_m,
            mesh.material[triangle],
            mesh.tint[triangle],
            mesh.normal[triangle],
            cast.road_m,
            lit,
            pixel_rad,
        )

    def _shaded(self, look: Look, hits: Hits) -> tuple[Floats32, Bytes]:
        ground = np.flatnonzero(hits.material == Material.GROUND)
        heading = self.site.line.heading(hits.road[ground, 0])
        cosine, sine = np.zeros((2, len(hits.depth)))
        cosine[ground], sine[ground] = np.cos(heading), np.sin(heading)
        return shade(look, self.site.surface, hits, cosine, sine)

    def render_view(
        self, camera: Camera, look: Look, finish: Finish, seed: int, lens: RadialLens | None = None
    ) -> RenderedView:
        """Render one image; the same arguments give the same pixels.

        Parameters
        ----------
        finish : exposure, blur and noise of the camera. seed : of the sensor noise.
        lens : of the camera, if not that of a pinhole.
        """
        size = camera.intrinsics.height_px, camera.intrinsics.width_px
        uv = _pixels(*size)
        directions = _pixel_rays(camera, uv, lens)
        cast = self.cast(camera.position_m, directions)
        lit = self.sunlit(cast, look.sun)
        pixel_rad = 1.0 / camera.intrinsics.focal_px
        colour, classes = self._shaded(look, self._hits(cast, directions, lit, pixel_rad))
        # Pixels at and beside the outlines of thin things.
        material = np.where(cast.triangle >= 0, self.site.mesh.material[cast.triangle], _NOTHING)
        thin = np.where(_THIN[material], 1 + self.site.mesh.object_id[cast.triangle], 0)
        image = thin.reshape(size).astype(np.float32)
        box = np.ones((3, 3), np.uint8)
        outline = cv2.dilate(image, box) != cv2.erode(image, box)
        # A far wire hits the centres of few of the pixels that it crosses.
        wire = (material == Material.WIRE).reshape(size).astype(np.uint8)
        rows = np.flatnonzero(outline | (cv2.dilate(wire, np.ones((5, 19), np.uint8)) > 0))
        for shift in _SUPER if len(rows) else []:
            turned = _pixel_rays(camera, uv[rows] + shift, lens)
            extra = self.cast(camera.position_m, turned)
            hits = self._hits(extra, turned, lit[rows], pixel_rad)
            colour[rows] += self._shaded(look, hits)[0]
        colour[rows] /= 1.0 + len(_SUPER)
        depth = np.where(
            cast.triangle >= 0, cast.range_m * (directions @ camera.rotation[2]), np.inf
        )
        picture = finish.apply(colour.reshape(*size, 3), np.random.default_rng(seed))
        return RenderedView(picture, classes.reshape(size), depth.astype(np.float32).reshape(size))


@cache
def _pixels(height: int, width: int) -> Floats:
    """Column and row (n, 2) of each pixel, row by row."""
    return np.indices((height, width), float)[::-1].reshape(2, -1).T


def _pixel_rays(camera: Camera, uv_px: Floats, lens: RadialLens | None) -> Floats:
    """`roadsight.geometry.cameras.pixel_directions`, without its temporary arrays."""
    own = camera.intrinsics
    straight = uv_px if lens is None else lens.undistort(uv_px)
    return _rays(straight, own.cx_px, own.cy_px, own.focal_px, camera.rotation)


@compiled()
def _rays(uv: Floats, cx: float, cy: float, focal: float, rotation: Floats) -> Floats:
    rays = np.empty((len(uv), 3))
    for i in range(len(uv)):
        x, y = (uv[i, 0] - cx) / focal, (uv[i, 1] - cy) / focal
        length = np.sqrt(x * x + y * y + 1.0)
        for k in range(3):
            rays[i, k] = (x * rotation[0, k] + y * rotation[1, k] + rotation[2, k]) / length
    return rays


@compiled()
def _sun_rays(
    cast: Cast, normal: Floats32, material: Bytes, leafy: Bools, sun: Floats
) -> tuple[Floats32, Ints, Floats]:
    """Share of the sun (n,) as far as it is known, hits that ask for it, and from where (k, 3).

    Parameters
    ----------
    normal, material : of triangles. leafy : of materials, whether they let some of the sun through.
    """
    count, asked = len(cast.range_m), 0
    lit = np.ones(count, np.float32)
    rows, start = np.empty(count, np.int64), np.empty((count, 3))
    for i in range(count):
        if cast.range_m[i] >= _SHADOW_REACH_M:
            continue
        number = cast.triangle[i]
        facing = np.float32(0.0)
        for k in range(3):
            facing += normal[number, k] * np.float32(sun[k])
        leaf = leafy[material[number]]
        if leaf and cast.range_m[i] > _LEAF_SHADOW_REACH_M:
            lit[i] = _FAR_LEAF_LIT
            continue
        if abs(facing) <= 0.01 or (leaf and facing <= 0.0):
            continue
        lift = 0.35 if leaf else _SHADOW_LIFT_M
        for k in range(3):
            start[asked, k] = cast.place_m[i, k] + lift * sun[k]
        rows[asked] = i
        asked += 1
    return lit, rows[:asked], start[:asked]


@compiled()
def _reach(
    origins: Floats, directions: Floats, found: FirstHits, triangles: Ints32, road_m: Floats
) -> tuple[Floats, Floats]:
    """Where rays end (n, 3), their origin if nowhere, and station and offset there (n, 2).

    Parameters
    ----------
    triangles : of the corridor, over which ``road_m`` (corners, 2) is linear; 0 beyond them.
    """
    place, road = np.empty(directions.shape), np.zeros((len(directions), 2))
    for i in range(len(directions)):
        number, start = found.triangle[i], min(i, len(origins) - 1)
        reach = float(found.range_m[i]) if number >= 0 else 0.0
        for k in range(3):
            place[i, k] = origins[start, k] + reach * directions[i, k]
        if 0 <= number < len(triangles):
            a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
            u, v = float(found.u[i]), float(found.v[i])
            for k in range(2):
                road[i, k] = (1.0 - u - v) * road_m[a, k] + u * road_m[b, k] + v * road_m[c, k]
    return place, road


@dataclass(frozen=True)
class Finish:
    """What the camera does to light.

    Parameters
    ----------
    exposure : gain. balance : (3,) gain of blue, green, red. blur_px : sigma of the lens.
    noise : sigma of the sensor's noise, of 255. gamma : of the encoding.
    """

    exposure: float = 1.0
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur_px: float = 0.55
    noise: float = 2.0
    gamma: float = 2.2

    def apply(self, linear: Floats32, rng: np.random.Generator) -> Bytes:
        """8-bit image (h, w, 3) of linear colours (h, w, 3)."""
        light = linear * (self.exposure * np.asarray(self.balance, np.float32))
        light = cv2.GaussianBlur(light, (0, 0), self.blur_px)
        light = light * (1.0 + 0.12 * light) / (1.0 + 0.55 * light) * 1.38
        encoded = 255.0 * np.power(np.clip(light, 0.0, 1.0), np.float32(1.0 / self.gamma))
        grain = rng.standard_normal(linear.shape[:2], np.float32) * np.float32(self.noise)
        return np.clip(encoded + grain[..., None] + 0.5, 0.0, 255.0).astype(np.uint8)
