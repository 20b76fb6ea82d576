"""Sightings as rays in local metres, and the pairs of rays that may show one pole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.sections.poles import Triangulation

FURTHEST_CAMERAS = 1.5  # two cameras may pair up to this many times the maximum distance to a pole


class TriangulationSettings(Triangulation):
    """How sightings become poles: a site's settings, and what no site sets.

    The papers state 25 m for the furthest pole, which the published code's unit makes 39 m in
    London.

    Parameters
    ----------
    min_baseline_m : cameras nearer to each other than this count as one place.
    sigma_bearing_deg : error of a bearing where a sighting states none.
    sigma_depth_ratio : error of a depth over the depth where a sighting states none.
    calibrate_depth : whether the common scale of the depths is found from the rays themselves.
    gate_chi2 : a sighting further from its pole (chi squared, 2 degrees of freedom) is better left
        alone.
    """

    min_baseline_m: float = 0.5
    sigma_bearing_deg: float = 2.0
    sigma_depth_ratio: float = 0.3
    calibrate_depth: bool = True
    gate_chi2: float = 8.0


# For cameras that a receiver alone placed, and not their alignment: places are less certain, and
# poles that were seen twice only are believed.
UNAIDED = TriangulationSettings(sigma_position_m=2.0, pole_evidence=-0.5)


@dataclass(frozen=True)
class Rays:
    """Sightings of one kind of object, one row each, in a canonical order.

    Parameters
    ----------
    camera_m : places of the cameras, shape (n, 2), local metres.
    bearing_deg : clockwise from grid north, in [0, 360).
    depth_m : monocular horizontal distance; NaN where unknown.
    sigma_bearing_deg, sigma_depth_m : 1 sigma; NaN where not stated.
    image : whole number for each image; two rays of one image never show the same pole.
    route, sequence : whole numbers; -1 where unknown.
    row : row of the sighting in the caller's table.
    anchored : whether the sighting ends at something whose own place is known, such as a column of
        a cloud: errors of the camera's place, heading and depth scale do not add to its sigmas.
    drift_m : 1 sigma of the camera's place that near images share, as a vector along its way, shape
        (n, 2), beside what the settings say; alignment knows a place along the road least.
    aside_m : the same across its way.
    turned_deg : signed error of the bearing for 1 sigma of its drive's principal point, of its
        drive's focal length, and of the heading that near images share, shape (n, 3).
    own_deg : what of ``sigma_bearing_deg`` neither these nor the place make up; NaN: all of it, to
        which they then add.
    """

    camera_m: Floats
    bearing_deg: Floats
    depth_m: Floats
    sigma_bearing_deg: Floats
    sigma_depth_m: Floats
    image: Ints
    route: Ints
    sequence: Ints
    row: Ints
    anchored: Bools
    drift_m: Floats
    aside_m: Floats
    turned_deg: Floats
    own_deg: Floats

    def __len__(self) -> int:
        return len(self.row)

    @property
    def direction(self) -> Floats:
        """Unit vectors, shape (n, 2)."""
        radians = np.radians(self.bearing_deg)
        return np.column_stack([np.sin(radians), np.cos(radians)])

    def take(self, chosen: NDArray) -> Rays:
        """Rays at ``chosen`` (numbers or a mask)."""
        return Rays(*(np.asarray(value)[chosen] for value in vars(self).values()))

    def scaled(self, factor: float) -> Rays:
        """The same rays with depths times ``factor``, but of those that are anchored."""
        by = np.where(self.anchored, 1.0, factor)
        return replace(self, depth_m=self.depth_m * by, sigma_depth_m=self.sigma_depth_m * by)


def make_rays(
    camera_m: NDArray,
    bearing_deg: NDArray,
    depth_m: NDArray | None = None,
    sigma_bearing_deg: NDArray | None = None,
    sigma_depth_m: NDArray | None = None,
    image: NDArray | None = None,
    route: NDArray | None = None,
    sequence: NDArray | None = None,
    anchored: NDArray | None = None,
    drift_m: NDArray | None = None,
    aside_m: NDArray | None = None,
    turned_deg: NDArray | None = None,
    own_deg: NDArray | None = None,
) -> Rays:
    """Rays in an order that does not depend on the order of the rows, without exact repeats.

    Depths and sigmas that are not positive and finite are unknown. Without images, cameras at the
    same place are one image. Rows whose camera or bearing is not finite are left out.

    Parameters
    ----------
    camera_m, drift_m, aside_m : shape (n, 2). turned_deg : shape (n, 3). Others: shape (n,); image
        may be of any kind that sorts.
    """
    camera = np.asarray(camera_m, np.float64).reshape(-1, 2)
    n = len(camera)
    wrapped = np.mod(np.asarray(bearing_deg, np.float64), 360.0)
    bearing = np.where(wrapped >= 360.0, 0.0, wrapped)  # from a tiny negative number
    places = _codes(list(map(tuple, camera.tolist())))
    depth, sigma_turn, sigma_depth = (
        _positive(column, n) for column in (depth_m, sigma_bearing_deg, sigma_depth_m)
    )
    labels = places if image is None else _codes(list(np.asarray(image).tolist()))
    route_codes = _whole(None if route is None else _codes(list(np.asarray(route).tolist())), n)
    sequences = _whole(sequence, n)
    rays = Rays(
        camera,
        bearing,
        depth,
        sigma_turn,
        sigma_depth,
        labels,
        route_codes,
        sequences,
        np.arange(n),
        np.zeros(n, bool) if anchored is None else np.asarray(anchored, bool),
        _vectors(drift_m, n, 2),
        _vectors(aside_m, n, 2),
        _vectors(turned_deg, n, 3),
        np.full(n, np.nan) if own_deg is None else np.asarray(own_deg, np.float64).reshape(n),
    )
    keys = [*rays.drift_m.T, *rays.aside_m.T, *rays.turned_deg.T, rays.own_deg]
    keys += [sequences, route_codes, labels, sigma_depth, sigma_turn, depth, bearing]
    order = np.lexsort([*map(np.nan_to_num, keys), camera[:, 1], camera[:, 0]])
    usable = np.isfinite(camera).all(axis=1) & np.isfinite(bearing)
    rays = rays.take(order[usable[order]])
    if len(rays) == 0:
        return rays
    # Without those that repeat another in everything but its row.
    numbers = (rays.image, rays.bearing_deg, np.nan_to_num(rays.depth_m), *rays.camera_m.T)
    _, first = np.unique(np.column_stack(numbers), axis=0, return_index=True)
    return rays.take(np.sort(first))


def _positive(values: NDArray | None, n: int) -> Floats:
    if values is None:
        return np.full(n, np.nan)
    numbers = np.asarray(values, np.float64)
    return np.where(np.isfinite(numbers) & (numbers > 0), numbers, np.nan)


def _whole(values: NDArray | None, n: int) -> Ints:
    if values is None:
        return np.full(n, -1, np.int64)
    return np.nan_to_num(np.asarray(values, np.float64), nan=-1.0).astype(np.int64)


def _vectors(values: NDArray | None, n: int, size: int) -> Floats:
    """Vectors (n, size), zero where unknown."""
    if values is None:
        return np.zeros((n, size))
    vectors = np.asarray(values, np.float64)
    return np.where(np.isfinite(vectors), vectors, 0.0)


def _codes(labels: list) -> Ints:
    """Numbers of labels in sorted order, so that they do not depend on the order of the rows."""
    known = {label: number for number, label in enumerate(sorted(set(labels)))}
    return np.array([known[label] for label in labels], np.int64)


def pair_rays(rays: Rays, settings: TriangulationSettings) -> Ints:
    """Pairs (m, 2) of rays of different images whose cameras are neither too near nor too far."""
    if len(rays) < 2:
        return np.empty((0, 2), np.int64)
    reach_m = FURTHEST_CAMERAS * settings.max_distance_m
    pairs = camera_pairs(rays, reach_m, settings.min_baseline_m)
    return pairs[rays.image[pairs[:, 0]] != rays.image[pairs[:, 1]]]


def camera_pairs(rays: Rays, reach_m: float, min_baseline_m: float) -> Ints:
    """Pairs (m, 2) of rays, in order, by the distance of their cameras."""
    pairs = cKDTree(rays.camera_m).query_pairs(reach_m, output_type="ndarray").astype(np.int64)
    pairs.sort(axis=1)
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    apart = np.hypot(*(rays.camera_m[pairs[:, 0]] - rays.camera_m[pairs[:, 1]]).T)
    return pairs[apart >= min_baseline_m]


def cross_rays(rays: Rays, pairs: Ints) -> tuple[Floats, Floats]:
    """Crossings of pairs of rays.

    Returns
    -------
    distances (m, 2) of the crossing along either ray, and its place (m, 2), metres; NaN for
    parallel rays, negative distances behind a camera
    """
    first, second = rays.direction[pairs[:, 0]], rays.direction[pairs[:, 1]]
    apart = rays.camera_m[pairs[:, 1]] - rays.camera_m[pairs[:, 0]]
    sine = _cross(first, second)
    parallel = np.abs(sine) < 1e-12
    sine = np.where(parallel, np.nan, sine)
    along = np.column_stack([_cross(apart, second) / sine, _cross(apart, first) / sine])
    return along, rays.camera_m[pairs[:, 0]] + along[:, :1] * first


def _cross(a: Floats, b: Floats) -> Floats:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
