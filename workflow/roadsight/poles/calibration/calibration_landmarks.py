"""A drive's mount, side views and track error from landmarks and points that images share."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.drift import MARK_OVERLAP, DriftModel
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.landmarks import (
    POSE,
    LandmarkNoise,
    Turns,
    mapped_rows,
    measure,
    observed_rows,
    slopes,
)
from roadsight.poles.alignment.locate import locate, own_variance, without_view
from roadsight.poles.alignment.pose import (
    CX,
    FOCAL,
    HEIGHT,
    INSETS,
    PITCH,
    ROLL,
    TURNS,
    YAW,
    Spread,
)
from roadsight.poles.alignment.solve import Fit, Task
from roadsight.poles.alignment.ties import Member
from roadsight.poles.calibration.calibration import (
    Loader,
    Mount,
    shared_mean,
    usable,
    with_centre_open,
    with_known,
)
from roadsight.poles.calibration.calibration_table import DriveCalibration, drift_of
from roadsight.poles.calibration.calibration_together import (
    Chain,
    Shared,
    Tied,
    in_order,
    is_tied,
    mount_together,
    told_centre,
    with_lens_sigmas,
)
from roadsight.poles.images.views import VIEWS

log = logging.getLogger(__name__)
# Rounds at most; on the generated roads three suffice
# (`docs/decisions/033-a-drive-is-solved-together.md`)
_ROUNDS = 8
_SETTLED = 0.1  # Rounds end when the drive's mean moves by less than this, in standard deviations
# Scales of the rounds, as of `mount_together`, where it is solved for how sure the lens is: on two
# generated drives the sigmas are within 4 % of those of all rounds, in 0.4 of the time
_LENS_SCALES = (12.0, 12.0, 6.0, 3.0, 3.0, 3.0)
# Turn of a side view as a share of the field of view, where views are made to be stitched
_STITCHED = 0.93
# One standard deviation of a side view's yaw when the view joins. The vote's own is far smaller,
# but it rests on a lens that is still to be solved.
_TURN_SIGMA_DEG = 0.5
_Posed = tuple[Place, Task, Fit]


def with_landmarks(
    calibration: DriveCalibration,
    places: Sequence[Place],
    loaders: Sequence[Loader],
    prior: Mount,
    noise: LandmarkNoise,
    side_yaw_deg: tuple[float, float],
    starts: Mapping[str, Floats],
    model: DriftModel,
    shared: Shared,
    centre_px: float,
) -> tuple[DriveCalibration, Mapping[str, Floats]]:
    """Calibration with what landmarks and shared points add, and the images' unknowns.

    The same if there are neither.

    Each round aligns every image under what the others say, then takes mount, side views and the
    error of the track from all of them, until they no longer move. Lens, side views and poses are
    solved together: a longer lens with side views turned less looks almost the same, and solving
    one after the other would stop far from the best. Side views join once their yaw is known
    roughly.

    Parameters
    ----------
    prior : what was known of the mount beforehand. side_yaw_deg : left and right, as far as known.
    starts : unknowns of the images, as road edges alone give them. model : of the receiver, as said
    beforehand. shared : points of images that follow each other. centre_px : one standard deviation
    of the principal point, which ``prior`` and calibration have in the middle.
    """
    chain = in_order(places, shared)

    def settled(
        calibration: DriveCalibration, prior: Mount, starts: Mapping[str, Floats], opened: bool
    ) -> tuple[DriveCalibration, Mount, Mapping[str, Floats], Sequence[_Posed]]:
        good: Sequence[_Posed] = ()
        for _ in range(_ROUNDS):
            images = [
                (place, load(*calibration.expected(place)))
                for place, load in zip(places, loaders, strict=True)
            ]
            if all(task.landmarks is None for _, task in images) and not is_tied(chain):
                break
            found = [(p, t, locate(t, noise, starts.get(p.image))) for p, t in images]
            good = [(p, t, fits[0]) for p, t, fits in found if usable(t, fits)]
            if len(good) < 3:
                break
            starts = {**starts, **{place.image: fit.unknowns for place, _, fit in good}}
            before = calibration.mount
            calibration = _improved(calibration, good, prior, model, chain)
            if not opened:
                calibration, prior = _opened(calibration, good, prior, noise, side_yaw_deg)
                opened = True
                continue
            moved = np.abs(calibration.mount.mean - before.mean)
            if (moved / np.sqrt(np.diag(calibration.mount.covariance))).max() < _SETTLED:
                break
        return calibration, prior, starts, good

    calibration, prior, starts, good = settled(calibration, prior, starts, opened=False)
    told = len(good) >= 3 and is_tied(chain) and not calibration.problem
    if not told:
        mount = with_centre_open(calibration.mount, centre_px)
        return replace(calibration, mount=mount), starts

    def solve(images: Sequence[Tied], prior: Mount) -> Mount:
        spread, drift = calibration.spread, calibration.drift.model
        return mount_together(images, prior, spread, drift, _LENS_SCALES)

    images = _chained(calibration, good, chain)
    mount, told = told_centre(images, calibration.mount, prior, centre_px, solve)
    calibration = replace(calibration, mount=mount)
    if told:
        prior = with_centre_open(prior, centre_px)
        calibration, prior, starts, good = settled(calibration, prior, starts, opened=True)
        images = _chained(calibration, good, chain)
        mount = with_lens_sigmas(images, calibration.mount, prior, solve)
        calibration = replace(calibration, mount=mount)
    point = calibration.mount.mean[CX], np.sqrt(calibration.mount.covariance[CX, CX])
    log.info("principal point %s: %.1f +- %.1f px", "found" if told else "not told", *point)
    return calibration, starts


def _improved(
    calibration: DriveCalibration,
    good: Sequence[_Posed],
    prior: Mount,
    model: DriftModel,
    chain: Chain,
) -> DriveCalibration:
    mount, spread = calibration.mount, calibration.spread
    if not calibration.problem:
        fits = [fit for _, _, fit in good]
        if is_tied(chain):
            images = _chained(calibration, good, chain)
            mount = mount_together(images, prior, spread, calibration.drift.model)
        else:
            mount = shared_mean(fits, prior, spread)
        spread = estimated_spread(fits, mount, Spread())
    measured = [(place, fit) for place, _, fit in good]
    drift, numbers = drift_of(measured, mount, spread, model)
    return replace(calibration, mount=mount, spread=spread, drift=drift, measured=numbers)


def _chained(calibration: DriveCalibration, good: Sequence[_Posed], chain: Chain) -> list[Tied]:
    found = {place.image: fit for place, _, fit in good}
    images = []
    for place, points in chain:
        fit = found.get(place.image)
        unknowns = calibration.expected(place)[0] if fit is None else fit.unknowns
        images.append(Tied(Member(place, unknowns, None, points), fit))
    return images


def _opened(
    calibration: DriveCalibration,
    good: Sequence[_Posed],
    prior: Mount,
    noise: LandmarkNoise,
    side_yaw_deg: tuple[float, float],
) -> tuple[DriveCalibration, Mount]:
    """Calibration that looks at the side views, and the prior that goes with it."""
    posed = [(task, fit) for _, task, fit in good]
    turns = side_turns(posed, _guesses(calibration, side_yaw_deg, posed), noise)
    log.info("side views: %s +- %s degrees", turns.deg, turns.sigma_deg)
    seen = np.flatnonzero(np.isfinite(turns.sigma_deg[1:])) + 1
    mounts = [calibration.mount, prior]
    for view in seen.tolist():
        number, turn = TURNS - 1 + view, turns.deg[view]
        mounts = [with_known(mount, number, turn, _TURN_SIGMA_DEG) for mount in mounts]
    return replace(calibration, mount=mounts[0]), mounts[1]


def _guesses(
    calibration: DriveCalibration,
    side_yaw_deg: tuple[float, float],
    images: Sequence[tuple[Task, Fit]],
) -> dict[str, list[float]]:
    """Where to look for the yaw of each side view: as given, and as for views that stitch."""
    width = calibration.key[1]
    hfov = 2 * np.degrees(np.arctan(0.5 * width / np.exp(calibration.mount.mean[FOCAL])))
    seen = {
        view
        for task, _ in images
        if task.landmarks is not None
        for view in VIEWS[1:]
        if len(task.landmarks.axes.seen_by(view))
    }
    pairs = zip(VIEWS[1:], side_yaw_deg, (-_STITCHED, _STITCHED), strict=True)
    return {view: [given, share * hfov] for view, given, share in pairs if view in seen}


# Yaw of a drive's side views, from the poles that they show and the front view's poses.
# The angle between two cameras is the same in every image, so every pole axis of a side view and
# every column near its ray vote for one; wrong pairs scatter, right ones agree.

_STEP_DEG = 0.02  # Step of the yaws whose votes are counted; the best one is refined afterwards
_REACH_DEG = 10.0  # How far to either side of a guess yaws are tried
_FARTHEST_M = 80.0  # Columns beyond this do not vote: more of them lie near every ray
_GATE = 3.0  # Standard deviations by which rows of foot and top may differ
_FEWEST = 6  # Votes that must agree on a yaw
_WRONG = 0.5  # Share of the axes whose vote is astray, since their pole is no column of the cloud
_APART_DEG = 0.6  # Yaws that differ by more are rivals of the best one, not its flank
# Log-likelihood by which the best yaw must lead its rivals, else the view stays unused
_CLEARER = 6.0
_LEAST_SIGMA_DEG = 0.005  # Standard deviation that many votes do not get below


def side_turns(
    images: Sequence[tuple[Task, Fit]],
    guesses_deg: Mapping[str, Sequence[float]],
    noise: LandmarkNoise,
) -> Turns:
    """Yaw of each side view; a view whose poles do not tell stays unused.

    The poses that a view's poles are compared with do not rest on these poles.

    Parameters
    ----------
    images : tasks with their poses. guesses_deg : by view; each is searched 10 degrees either way.
    """
    deg, sigma = list(Turns().deg), list(Turns().sigma_deg)
    for view, guesses in guesses_deg.items():
        if not guesses:
            continue
        found = _turn(images, view, np.array(guesses, float), noise)
        number = VIEWS.index(view)
        deg[number], sigma[number] = found if found is not None else (float(guesses[0]), np.inf)
    return Turns((deg[0], deg[1], deg[2]), (sigma[0], sigma[1], sigma[2]))


def _turn(
    images: Sequence[tuple[Task, Fit]], view: str, guesses_deg: Floats, noise: LandmarkNoise
) -> tuple[float, float] | None:
    """Yaw and sigma in degrees, None if the votes do not agree."""
    guess = float(guesses_deg[0])
    votes = [_votes(t, without_view(t, fit, view), view, guess, noise) for t, fit in images]
    votes = [vote for vote in votes if len(vote)]
    if not votes:
        return None
    first = np.concatenate([[0], np.cumsum([vote[:, 0].max() + 1 for vote in votes])[:-1]])
    table = np.concatenate([v + np.array([n, 0, 0]) for v, n in zip(votes, first, strict=True)])
    grid = np.arange(-180.0, 180.0, _STEP_DEG)
    near = np.abs(grid[:, None] - guesses_deg).min(axis=1) <= _REACH_DEG
    grid = grid[near]
    # Log-likelihood of each yaw: every axis has one vote, about half of them are astray.
    axes = table[:, 0].astype(np.int64)
    score = np.zeros(len(grid))
    for axis in np.unique(axes):
        _, turn, sigma = table[axes == axis].T
        off = (grid[:, None] - turn) / sigma
        density = (np.exp(-0.5 * off**2) / (2.5066 * sigma)).sum(axis=1)  # The root of 2 pi.
        score += np.log(_WRONG / (2 * _REACH_DEG) + (1.0 - _WRONG) * density)
    best = int(np.argmax(score))
    others = score[np.abs(grid - grid[best]) > _APART_DEG]
    if len(others) and score[best] - others.max() < _CLEARER:
        return None
    # Weighted robust mean of the votes around the best yaw.
    close = np.abs(table[:, 1] - grid[best]) < 4.0 * table[:, 2] + 2.0 * _STEP_DEG
    if np.count_nonzero(close) < _FEWEST:
        return None
    _, turn, sigma = table[close].T
    mean = grid[best]
    for _ in range(10):
        weight = (1.0 + ((turn - mean) / (2.0 * sigma)) ** 2) ** -2 / sigma**2
        mean = float((weight * turn).sum() / weight.sum())
    return mean, float(np.hypot(1.0 / np.sqrt(MARK_OVERLAP * weight.sum()), _LEAST_SIGMA_DEG))


def _votes(task: Task, fit: Fit, view: str, guess_deg: float, noise: LandmarkNoise) -> Floats:
    """Rows (k, 3): number of the axis, yaw that would put it on a column, its sigma (degrees)."""
    sight = task.landmarks
    own = sight.axes.seen_by(view) if sight is not None else np.empty(0, np.int64)
    if sight is None or not len(own):
        return np.empty((0, 3))
    axis = np.repeat(own, len(sight.columns.top_m))
    column = np.tile(np.arange(len(sight.columns.top_m)), len(own))
    start, pose = task.scene[0], fit.unknowns
    seen = observed_rows(sight.axes)[axis]
    seen[:, 5:] = 0.0, np.radians(guess_deg)  # As if in the front view, turned by themselves.
    seen[:, 0] += pose[CX]
    there = mapped_rows(sight.columns, task.origin_m)[column]
    for _ in range(2):  # A tilted camera turns its views not quite by the bearings' difference.
        seen[:, 6] -= measure(pose, start, seen, there)[:, 0]
    rows = measure(pose, start, seen, there)
    good = (rows[:, 3] > noise.nearest_m) & (rows[:, 3] < _FARTHEST_M) & np.isfinite(rows[:, 1])
    axis, column = axis[good], column[good]
    seen, there, rows = seen[good], there[good], rows[good]
    slope = slopes(pose, start, seen, there)[..., :POSE]
    open_ = np.einsum("nia,ab,nib->ni", slope, fit.covariance[:POSE, :POSE], slope)
    focal = np.exp(pose[6]) * sight.axes.scale[axis]
    foot, top = (
        np.sqrt(noise.foot_px**2 + (height_m * focal / rows[:, 3]) ** 2 + open_[:, k])
        for k, height_m in ((1, noise.ground_m), (2, noise.top_m))
    )
    agrees = np.where(
        sight.axes.foot_visible[axis], np.abs(rows[:, 1]) < _GATE * foot, rows[:, 1] < _GATE * foot
    )
    cut = sight.axes.top_cut[axis]
    open_top = sight.columns.open_top[column]
    agrees &= (open_top | (rows[:, 2] > -_GATE * top)) & (cut | (rows[:, 2] < _GATE * top))
    sigma_m = sight.columns.sigma_m[column]
    variance = open_[:, 0] + own_variance(sight.axes.sigma_px[axis], sigma_m, rows)
    turn_deg = (np.degrees(seen[:, 6]) + 180.0) % 360.0 - 180.0
    number = np.searchsorted(own, axis)
    return np.column_stack([number, turn_deg, np.degrees(np.sqrt(variance))])[agrees]


# How much the images of a drive differ from its mean, from the images themselves.
# A smooth road and a stiff vehicle leave a camera's height and roll almost as they are, a worn
# road does not. What images may differ by decides how much each of them can lean on the others.

# Values of `Spread` that are estimated: the unknowns that share each, and its least, metres and
# degrees (with none, images could not differ at all)
_ESTIMATED = {
    "height_m": ([HEIGHT], 0.01),
    "yaw_deg": ([YAW], 0.05),
    "pitch_deg": ([PITCH], 0.05),
    "roll_deg": ([ROLL], 0.05),
    "lane_inset_m": ([INSETS, INSETS + 1], 0.01),
    "border_inset_m": ([INSETS + 2, INSETS + 3], 0.01),
}
_STEPS = 30  # Steps of expectation maximisation
_KNOWN_IMAGES = 10.0  # How many images the expected spread counts as
# An image further from the mean than this, in standard deviations, does not widen the spread
_FAR = 4.0


def estimated_spread(fits: Sequence[Fit], mount: Mount, expected: Spread) -> Spread:
    """Spread under which the images are likeliest, by expectation maximisation.

    variance = mean over the images of (posterior deviation from the mean)^2 + posterior variance,
    repeated until it stays (Dempster, Laird and Rubin 1977). What no image tells keeps the
    expected value, which counts as much as ten images. The place on the road is left out: its error
    is the track's.

    Parameters
    ----------
    fits : of the images. expected : the spread of any drive.
    """
    normal = np.stack([fit.normal for fit in fits])
    towards = np.stack([fit.normal @ (fit.unknowns - mount.mean) - fit.gradient for fit in fits])
    before = expected.vector() ** 2
    variance = before.copy()
    for _ in range(_STEPS):
        covariance = np.linalg.inv(normal + np.diag(1.0 / variance))
        apart = np.einsum("nij,nj->ni", covariance, towards)
        usual = apart**2 <= _FAR**2 * variance
        second = np.where(usual, apart**2 + np.diagonal(covariance, axis1=1, axis2=2), 0.0)
        for numbers, _ in _ESTIMATED.values():
            total = second[:, numbers].sum() + _KNOWN_IMAGES * before[numbers].sum()
            count = usual[:, numbers].sum() + _KNOWN_IMAGES * len(numbers)
            variance[numbers] = total / count
    found = {
        name: max(float(np.sqrt(variance[numbers[0]])), least)
        for name, (numbers, least) in _ESTIMATED.items()
    }
    return replace(expected, **found)
