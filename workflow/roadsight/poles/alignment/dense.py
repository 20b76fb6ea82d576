"""Pose of one image with a known lens, from all that photograph, masks and cloud share.

Samples of the cloud as seen from the expected pose (`visible`) look up fields of the image
(`poles.images.evidence`); their sum is a log-likelihood ratio. Search: many starts at a wide blur,
the best of them descend at narrower ones, and the last few see the cloud anew from where they are.
The covariance is that of an M-estimator, with the image's tiles as what is independent (Huber
1967), and with what all samples of an image have in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.kernels import compiled
from roadsight.geometry.cameras import cam_from_world
from roadsight.poles.alignment.kernel import DEGREE, turned
from roadsight.poles.alignment.visible import FIELD_OF, SceneCloud, visible_samples
from roadsight.poles.images.evidence import ImageEvidence

# What a sample of each kind (`visible`) counts: neighbours repeat each other. Of surfaces 0.02 to
# 0.003 does as well within one image of 25, 0.1 lets wrong classes pull roll and pitch; all
# weights twice or half as large change nothing.
_WEIGHT = np.array([0.1, 0.1, 0.1, 0.1, 0.01, 0.01, 0.1, 0.1])
# Blur of the first look: 2 degrees are 25 px at 720 px of focal length, and the starts lie closer
_WIDEST_PX = 16.0
_BLURS_PX = (8.0, 4.0)  # Blurs of the first descents; each keeps the best of the last
FINEST_PX = 2.0  # Blur of the last descent; edges of image and cloud agree to about that
_TRIALS = 384  # Starts. A grid of 3 x 3 x 3 found 89 % of 100 poses that these find at 96 %.
_FARTHEST = 2.2  # Starts lie within this many expected standard deviations
_CHOSEN = 12  # Starts that descend at 8 px; half of them go on at 4 px, a quarter at 2 px
_APART = 0.5  # Chosen starts differ by this share of an expected standard deviation in some unknown
_SAME = 0.1  # Minima that differ by less in all unknowns are one
# Tiles whose samples err alike: with 40 px sigmas are a fifth smaller, with 160 px they scatter
_TILE_PX = 80
# Error that all samples of an image share, of lens and rectification. Without it 39 % of headings
# lie within one sigma and 60 % within two; with 1.0 px 78 and 100 % of 45 single photographs of
# five streets, 39 and 74 % of 31 views of a drive (0.7 px: 64 and 98 %, 29 and 68 %).
FLOOR_PX = 1.0
FLOOR_M = 0.05  # The same of the cloud: registration of its scans
# Depth at which most samples lie: a wrong focal length moves a camera by that share of it
_DEPTH_M = 20.0
# A second pose that is nearer than this in all unknowns does no harm; metres and degrees
_SECOND = np.array([0.5, 0.5, 0.5, 0.25, 0.25, 0.25])
# Spread of the poses that the best one is compared with, whatever was expected: what a videolog
# leaves open
_ELSEWHERE = np.array([0.7, 0.7, 0.1, 2.0, 1.0, 1.0])
# Blur of that comparison: at 2 px chance hits scatter, at 8 px the best pose stands out less
_LEAD_PX = 4.0


@dataclass(frozen=True)
class GivenLens:
    """A known lens without distortion, in pixels of the image, and one standard deviation of each.

    Attributes
    ----------
    focal_px, cx_px, cy_px : focal length and principal point.
    """

    focal_px: float
    cx_px: float
    cy_px: float
    sigma_focal_px: float = 0.0
    sigma_cx_px: float = 0.0
    sigma_cy_px: float = 0.0

    def vector(self, scale: float) -> Floats:
        """Focal length and principal point (3,) in an image that is ``scale`` times as large.

        Pixel centres have whole coordinates: the image begins at -0.5.
        """
        cx, cy = ((c + 0.5) * scale - 0.5 for c in (self.cx_px, self.cy_px))
        return np.array([self.focal_px * scale, cx, cy])


@dataclass(frozen=True)
class DenseTask:
    """One image with the cloud around it and where its camera is expected.

    Attributes
    ----------
    pose : (6,) x, y, z (m), heading, pitch, roll (degrees). covariance : (6, 6) of along, lateral,
        up (m; along and right of that heading), yaw, pitch, roll (degrees).
    """

    cloud: SceneCloud
    evidence: ImageEvidence
    lens: GivenLens
    pose: Floats
    covariance: Floats

    @property
    def sigma(self) -> Floats:
        """Expected standard deviation (6,) of each unknown."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def prior_information(self) -> Floats:
        """Inverse (6, 6) of the covariance."""
        return np.asarray(np.linalg.inv(self.covariance), np.float64)


@dataclass(frozen=True)
class DenseFit:
    """A pose.

    Attributes
    ----------
    offsets : (6,) from the expected pose. pose : (6,) x, y, z (m), heading, pitch, roll (degrees).
    covariance : (6, 6) of the offsets. cost : negative log-likelihood ratio, the expectation's
    part included. gain : log-likelihood ratio of the image alone. second : by how much more the
    best pose elsewhere costs, infinite without any. lead : log-likelihood ratio beyond the best of
    many random poses around. samples : how many there were.
    """

    offsets: Floats
    pose: Floats
    covariance: Floats
    cost: float
    gain: float
    second: float
    lead: float
    samples: int

    @property
    def sigma(self) -> Floats:
        """One standard deviation (6,) of each offset."""
        return np.sqrt(np.diag(self.covariance))


def align_dense(task: DenseTask) -> DenseFit:
    """The pose that photograph and cloud agree on best."""
    zero, unit = np.zeros(SIZE), task.sigma
    samples = gather(task, zero).thinned(4)
    prior = task.prior_information
    trials = _starts() @ np.linalg.cholesky(task.covariance).T
    costs = [
        0.5 * trial @ prior @ trial - evaluate(task, samples, _WIDEST_PX, trial, False)[0]
        for trial in trials
    ]
    chosen = _distinct(list(zip(costs, trials, strict=True)), unit, _APART, _CHOSEN)
    first = [descend_dense(task, samples, _BLURS_PX[0], trial, 8) for _, trial in chosen]
    second = [
        descend_dense(task, gather(task, offsets).thinned(3), _BLURS_PX[1], offsets, 10)
        for _, offsets in _distinct(first, unit, _SAME, _CHOSEN // 2)
    ]
    last = []
    for minimum in _distinct(second, unit, _SAME, _CHOSEN // 4):
        found = minimum
        for _ in range(2):  # each time with what is seen from where the last descent ended
            found = descend_dense(task, gather(task, found[1]), FINEST_PX, found[1], 10)
        last.append(found)
    last.sort(key=lambda found: found[0])
    return _fit(task, last)


def _starts() -> Floats:
    """Offsets (t, 6) in standard deviations, the expected pose first."""
    from scipy.stats import norm, qmc  # noqa: PLC0415  # slow to load

    points = qmc.Halton(SIZE, scramble=False).random(_TRIALS + 1)[1:]
    starts = np.clip(norm.ppf(points), -_FARTHEST, _FARTHEST)
    starts[0] = 0.0
    return np.asarray(starts, np.float64)


def _distinct(
    found: list[tuple[float, Floats]], unit: Floats, apart: float, count: int
) -> list[tuple[float, Floats]]:
    """The best that differ from each other in some unknown by more than a share of its unit."""
    kept: list[tuple[float, Floats]] = []
    for cost, offsets in sorted(found, key=lambda minimum: minimum[0]):
        if all(np.abs((offsets - other) / unit).max() > apart for _, other in kept):
            kept.append((cost, offsets))
        if len(kept) == count:
            break
    return kept


def descend_dense(
    task: DenseTask, samples: Samples, blur_px: float, offsets: Floats, steps: int
) -> tuple[float, Floats]:
    """Levenberg-Marquardt at one blur with Fisher's information; cost and offsets where it ends."""
    prior, unit = task.prior_information, task.sigma
    state = _state(task, samples, blur_px, prior, offsets)
    damping, stretch = 1e-2, 1.0
    for _ in range(steps):
        normal = state.normal * np.outer(unit, unit)
        damped = normal + damping * np.diag(np.diag(normal))
        step = -np.linalg.solve(damped, state.slope * unit) * unit
        trial = _state(task, samples, blur_px, prior, offsets + stretch * step)
        if trial.cost < state.cost:
            offsets, gained, state = offsets + stretch * step, state.cost - trial.cost, trial
            damping, stretch = max(damping * 0.3, 1e-6), min(1.6 * stretch, 4.0)
            # The cost is a log-likelihood: so little more decides nothing.
            if gained < 1e-3:
                break
        elif stretch > 1.0:
            stretch = 1.0
        else:
            damping = max(damping * 6.0, 1e-3)
            if damping > 1e4:
                break
    return state.cost, offsets


@dataclass(frozen=True)
class _State:
    cost: float
    slope: Floats
    normal: Floats
    by_tile: Floats
    information: Floats


def _state(
    task: DenseTask, samples: Samples, blur_px: float, prior: Floats, offsets: Floats
) -> _State:
    """Cost of a pose with the expectation's part, and its slopes."""
    gain, by_tile, information = _scored(task, samples, blur_px, offsets, True)
    pull = prior @ offsets
    cost = 0.5 * float(offsets @ pull) - gain
    return _State(cost, pull - by_tile.sum(axis=0), information + prior, by_tile, information)


def evaluate(
    task: DenseTask, samples: Samples, blur_px: float, offsets: Floats, slopes: bool = True
) -> tuple[float, Floats, Floats]:
    """Log-likelihood ratio of the image alone, gradient (6,), Fisher's information (6, 6)."""
    gain, by_tile, information = _scored(task, samples, blur_px, offsets, slopes)
    return gain, by_tile.sum(axis=0), information


def _scored(
    task: DenseTask, samples: Samples, blur_px: float, offsets: Floats, slopes: bool
) -> tuple[float, Floats, Floats]:
    """The same with the gradient by tile (tiles, 6)."""
    start = np.concatenate([task.pose[:3], np.radians(task.pose[3:])])
    lens, fields = task.lens.vector(task.evidence.scale), task.evidence.at(blur_px)
    seen = samples.xyz_m, samples.field, samples.weight, samples.tile, samples.tiles
    found: tuple[float, Floats, Floats] = score(offsets, start, lens, *seen, fields, slopes)
    return found


@dataclass(frozen=True)
class Samples:
    """What a camera sees of a cloud: places (n, 3), fields, weights and tiles (n,) of samples."""

    xyz_m: Floats
    field: Ints
    weight: Floats
    tile: Ints
    tiles: int

    def thinned(self, step: int) -> Samples:
        """Every ``step``-th sample, counting as much as all."""
        own = np.ascontiguousarray
        field, tile = own(self.field[::step]), own(self.tile[::step])
        weight = own(self.weight[::step]) * step
        return Samples(own(self.xyz_m[::step]), field, weight, tile, self.tiles)


def gather(task: DenseTask, offsets: Floats) -> Samples:
    """What the camera sees of the cloud from a pose."""
    pose, lens = moved(task.pose, offsets), task.lens.vector(task.evidence.scale)
    rotation = cam_from_world(*pose[3:])
    kinds, points = visible_samples(task.cloud, rotation, pose[:3], lens, task.evidence.shape)
    xyz = np.ascontiguousarray(task.cloud.xyz_m[points])
    seen = (xyz - pose[:3]) @ rotation.T
    high, broad = task.evidence.shape
    column = np.clip(lens[1] + lens[0] * seen[:, 0] / seen[:, 2], 0, broad - 1) // _TILE_PX
    row = np.clip(lens[2] + lens[0] * seen[:, 1] / seen[:, 2], 0, high - 1) // _TILE_PX
    columns, rows = int(np.ceil(broad / _TILE_PX)), int(np.ceil(high / _TILE_PX))
    tile = (row * columns + column).astype(np.int64)
    return Samples(xyz, FIELD_OF[kinds], _WEIGHT[kinds], tile, columns * rows)


def moved(pose: Floats, offsets: Floats) -> Floats:
    """Pose (6,) that lies ``offsets`` (6,) from another; metres and degrees."""
    heading = np.radians(pose[YAW])
    east, north = np.sin(heading), np.cos(heading)
    axes = np.array([[east, north, 0.0], [north, -east, 0.0], [0.0, 0.0, 1.0]])
    return np.concatenate([pose[:3] + offsets[:3] @ axes, pose[3:] + offsets[3:]])


def _fit(task: DenseTask, minima: list[tuple[float, Floats]]) -> DenseFit:
    """The best of the minima, sorted by cost, with what is known of it."""
    cost, offsets = minima[0]
    samples = gather(task, offsets)
    prior = task.prior_information
    state = _state(task, samples, FINEST_PX, prior, offsets)
    second = min(
        (
            other - cost
            for other, elsewhere in minima[1:]
            if (np.abs(elsewhere - offsets) > _SECOND).any()
        ),
        default=np.inf,
    )
    # Sandwich covariance of an M-estimator whose independent parts are the image's tiles.
    bread = np.linalg.inv(state.information + prior)
    sandwich = np.asarray(bread @ (state.by_tile.T @ state.by_tile + prior) @ bread, np.float64)
    # An image of another place fits somewhere, too, but hardly better than at random.
    few = samples.thinned(4)
    around = _starts()[1::2] * _ELSEWHERE
    around = around[(np.abs(around) > _SECOND).any(axis=1)]
    others = [evaluate(task, few, _LEAD_PX, offsets + one, False)[0] for one in around]
    return DenseFit(
        offsets,
        moved(task.pose, offsets),
        sandwich + np.diag(common_sigma(task.lens) ** 2),
        cost,
        gain=0.5 * float(offsets @ prior @ offsets) - state.cost,
        second=second,
        lead=evaluate(task, few, _LEAD_PX, offsets, False)[0] - max(others),
        samples=len(samples.xyz_m),
    )


def common_sigma(lens: GivenLens) -> Floats:
    """Standard deviation (6,) of what all samples of an image share, so that none averages it out.

    A wrong principal point turns the camera; a wrong focal length moves it along its view.
    """
    across, down = (np.hypot(FLOOR_PX, s) for s in (lens.sigma_cx_px, lens.sigma_cy_px))
    ahead_m = np.hypot(FLOOR_M, _DEPTH_M * lens.sigma_focal_px / lens.focal_px)
    turn = np.degrees(np.array([across, down, FLOOR_PX]) / lens.focal_px)
    return np.concatenate([[ahead_m, FLOOR_M, FLOOR_M], turn])


# The unknowns, and numbers of two of them: along, lateral (right), up (metres; along and right of
# the start's heading), yaw, pitch, roll (degrees). Axes and angles as in `geometry.cameras`.
SIZE, YAW, PITCH = 6, 3, 4
_NEAREST_M = 0.5  # Samples nearer than this, or behind the camera, are in no image


@compiled()
def score(  # noqa: PLR0912
    offsets: Floats,
    pose: Floats,
    lens: Floats,
    xyz_m: Floats,
    field: Ints,
    weight: Floats,
    tile: Ints,
    tiles: int,
    fields: Floats32,
    slopes: bool,
) -> tuple[float, Floats, Floats]:
    """Sum of the samples' log-likelihood ratios, its gradient by tile, Fisher's information.

    Parameters
    ----------
    offsets : (6,) from the pose, see above. pose : (6,) x, y, z (m), heading, pitch, roll (rad).
    lens : (3,) focal length, principal point u, v; px of the fields.
    xyz_m : (n, 3) samples. field, weight, tile : (n,) which field each looks up, how much it
        counts, and which part of the image it is in. tiles : how many parts there are.
    fields : (f, h, w), see `poles.images.evidence`. slopes : False: the sum alone.

    Returns
    -------
    sum, gradient (tiles, 6), information (6, 6); samples outside the image count nothing
    """
    total = 0.0
    gradient = np.zeros((tiles, SIZE))
    information = np.zeros((SIZE, SIZE))
    turns = turned(
        pose[3] + offsets[3] * DEGREE, pose[4] + offsets[4] * DEGREE, pose[5] + offsets[5] * DEGREE
    )
    north, east = np.cos(pose[3]), np.sin(pose[3])
    # Rows: along, right and up in the world.
    axes = np.array([[east, north, 0.0], [north, -east, 0.0], [0.0, 0.0, 1.0]])
    centre = np.empty(3)
    for k in range(3):
        moved = offsets[0] * axes[0, k] + offsets[1] * axes[1, k] + offsets[2] * axes[2, k]
        centre[k] = pose[k] + moved
    focal = lens[0]
    rotation = turns[0]
    motion = np.zeros((3, 3))
    for r in range(3):
        for j in range(3):
            for k in range(3):
                motion[r, j] += rotation[r, k] * axes[j, k]
    high, broad = fields.shape[1], fields.shape[2]
    row = np.empty(SIZE)
    away = np.empty(3)
    for i in range(len(xyz_m)):
        for k in range(3):
            away[k] = xyz_m[i, k] - centre[k]
        x = rotation[0, 0] * away[0] + rotation[0, 1] * away[1] + rotation[0, 2] * away[2]
        y = rotation[1, 0] * away[0] + rotation[1, 1] * away[1] + rotation[1, 2] * away[2]
        z = rotation[2, 0] * away[0] + rotation[2, 1] * away[1] + rotation[2, 2] * away[2]
        if z < _NEAREST_M:
            continue
        u, v = lens[1] + focal * x / z, lens[2] + focal * y / z
        if not (u >= 0 and v >= 0 and u < broad - 1 and v < high - 1):
            continue
        a, b = int(u), int(v)
        right, down = u - a, v - b
        own = fields[field[i]]
        share_00, share_01 = (1 - right) * (1 - down), right * (1 - down)
        share_10, share_11 = (1 - right) * down, right * down
        total += weight[i] * (
            share_00 * own[b, a]
            + share_01 * own[b, a + 1]
            + share_10 * own[b + 1, a]
            + share_11 * own[b + 1, a + 1]
        )
        if not slopes:
            continue
        # Central differences at the four pixels, as smooth as the field itself.
        a_0, a_3 = max(a - 1, 0), min(a + 2, broad - 1)
        b_0, b_3 = max(b - 1, 0), min(b + 2, high - 1)
        by_u = 0.5 * (
            share_00 * (own[b, a + 1] - own[b, a_0])
            + share_01 * (own[b, a_3] - own[b, a])
            + share_10 * (own[b + 1, a + 1] - own[b + 1, a_0])
            + share_11 * (own[b + 1, a_3] - own[b + 1, a])
        )
        by_v = 0.5 * (
            share_00 * (own[b + 1, a] - own[b_0, a])
            + share_01 * (own[b + 1, a + 1] - own[b_0, a + 1])
            + share_10 * (own[b_3, a] - own[b, a])
            + share_11 * (own[b_3, a + 1] - own[b, a + 1])
        )
        by_x, by_y = by_u * focal / z, by_v * focal / z
        by_z = -(by_x * x + by_y * y) / z
        for j in range(3):
            row[j] = -(by_x * motion[0, j] + by_y * motion[1, j] + by_z * motion[2, j])
            turn = turns[j + 1]
            turn_x = turn[0, 0] * away[0] + turn[0, 1] * away[1] + turn[0, 2] * away[2]
            turn_y = turn[1, 0] * away[0] + turn[1, 1] * away[1] + turn[1, 2] * away[2]
            turn_z = turn[2, 0] * away[0] + turn[2, 1] * away[1] + turn[2, 2] * away[2]
            row[3 + j] = (by_x * turn_x + by_y * turn_y + by_z * turn_z) * DEGREE
        for j in range(SIZE):
            gradient[tile[i], j] += weight[i] * row[j]
            for k in range(j + 1):
                information[j, k] += weight[i] * row[j] * row[k]
    for j in range(SIZE):
        for k in range(j):
            information[k, j] = information[j, k]
    return total, gradient, information
