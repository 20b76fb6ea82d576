from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg
from roadsight.poles.alignment.drive import near_edges, places_of, sight_of
from roadsight.poles.alignment.landmarks import LandmarkNoise, landmark_misfit, measure, slopes
from roadsight.poles.alignment.locate import (
    admissible,
    associate,
    locate,
    match_landmarks,
    without_view,
)
from roadsight.poles.alignment.pose import INSETS, TURNS, Spread, pose_of
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.poles.alignment.solve import ImageEdges, Noise, Task, search
from roadsight.poles.calibration.calibration_landmarks import side_turns
from roadsight.poles.images.views import turned
from roadsight.poles.sightings.lidar_poles import PoleColumns
from tests.helpers.road_bed import RoadBed, frames_of

NOISE = LandmarkNoise()
SPREAD = Spread(along_m=1.0)
SIDE_DEG = 40.0
HEIGHT_M = 9.0


@pytest.fixture(scope="module")
def bed():
    return RoadBed(seed=5, images=12, gps_m=0.5)


@pytest.fixture(scope="module")
def columns(bed):
    """Poles aside of the track, about every 25 m."""
    rng = np.random.default_rng(3)
    heading = np.radians([pose.heading_deg for pose in bed.truth])
    right = np.column_stack([np.cos(heading), -np.sin(heading)])
    feet = []
    for k in range(0, bed.images, 2):
        for side in (-1.0, 1.0):
            feet.append(bed.track[k] + side * rng.uniform(8.0, 12.0) * right[k])
    ahead = np.column_stack([np.sin(heading[-1:]), np.cos(heading[-1:])])
    for far in (30.0, 60.0, 90.0):
        feet.append(bed.track[-1] + far * ahead[0] + rng.uniform(-12, 12) * right[-1])
    xy = np.array(feet)
    nearest = np.hypot(*(xy[:, None] - bed.track).transpose(2, 0, 1)).argmin(axis=1)
    ground = np.asarray(bed.z_road)[nearest]
    sigma = np.full(len(xy), 0.03)
    return PoleColumns(xy, np.full(len(xy), HEIGHT_M), sigma, ground, np.full(len(xy), 9.0))


def axis_rows(bed, number, columns, rng, views=("front",)):
    """What the masks of one place show of the columns, with noise of a third of a pixel."""
    pose = bed.truth[number]
    camera = Intrinsics.centred(bed.width_px, bed.height_px, bed.intrinsics.focal_px)
    front = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
    rows = []
    for view in views:
        rotation = turned(front, {"front": 0.0, "left": -SIDE_DEG, "right": SIDE_DEG}[view])
        for foot, ground in zip(columns.xy_m, columns.z_ground_m, strict=True):
            line = np.column_stack([np.tile(foot, (9, 1)), ground + np.linspace(0, HEIGHT_M, 9)])
            uv, depth = project(camera, rotation, pose.position_m, line)
            if depth.min() < 5.0 or np.hypot(*(foot - pose.position_m[:2])) > 150.0:
                continue
            inside = camera.contains(uv)
            if inside.sum() < 3:
                continue
            (u0, low), (u1, top) = uv[inside][0], uv[inside][-1]
            rows.append(
                {
                    "view": view, "u": 0.5 * (u0 + u1) + rng.normal(0, 0.3), "v": 0.5 * (low + top),
                    "v_foot": low, "v_top": top, "width_px": 4.0, "width_view_px": bed.width_px,
                    "height_view_px": bed.height_px, "foot_visible": bool(inside[0]),
                    "top_cut": not inside[-1], "slope": (u0 - u1) / (low - top),
                }
            )  # fmt: skip
    names = [
        "view", "u", "v", "v_foot", "v_top", "width_px", "width_view_px", "height_view_px",
        "foot_visible", "top_cut", "slope",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def tasks_of(bed, columns, views=("front",), known=None, side_deg=(0.0, 0.0), side_sigma_deg=60.0):
    rng = np.random.default_rng(8)
    edges = RoadEdges.from_points(bed.road_edges)
    m = bed.mount
    mean = np.array(
        [
            0, m.lateral_m, m.height_m, m.yaw_deg, m.pitch_deg, m.roll_deg - 1.146,
            np.log(bed.intrinsics.focal_px), 0, 0.5, 0.5, 0, 0, *side_deg,
        ]
    )  # fmt: skip
    sigma = SPREAD.vector()
    sigma[TURNS:] = side_sigma_deg
    information = np.diag(1.0 / sigma**2)
    for number, place in enumerate(places_of(frames_of(bed), edges)):
        rows = bed.seen[number]
        seen = ImageEdges.from_pixels(rows[:, :2], rows[:, 2], rows[:, 3] > 0.5)
        axes = axis_rows(bed, number, columns, rng, views)
        sight = sight_of(place, axes, known or columns, NOISE)
        map_edges = near_edges(place, edges, Reach())
        yield Task(place.start, seen, map_edges, Noise(), mean, information, sight)


@pytest.fixture(scope="module")
def tasks(bed, columns):
    return list(tasks_of(bed, columns))


def errors_of(bed, tasks, fits):
    """Heading and along-track errors."""
    rows = []
    for truth, task, fit in zip(bed.truth, tasks, fits, strict=True):
        pose = pose_of(task.start, fit.unknowns)
        turn = np.radians(truth.heading_deg)
        gap = pose.position_m - truth.position_m
        along = gap[0] * np.sin(turn) + gap[1] * np.cos(turn)
        rows.append([float(wrap_deg(pose.heading_deg - truth.heading_deg)), along])
    return np.abs(rows)


def test_landmarks_improve_heading_and_place_along(bed, tasks):
    before = errors_of(bed, tasks, [search(task)[0] for task in tasks])
    fits = [locate(task)[0] for task in tasks]
    after = errors_of(bed, tasks, fits)
    assert np.median([len(fit.matched.pairs) for fit in fits if fit.matched is not None]) >= 2
    assert np.mean(after[:, 0] < 0.1) >= 0.9
    assert after[:, 0].mean() < before[:, 0].mean()
    assert after[:, 1].mean() < 0.7 * before[:, 1].mean()


def test_pairs_are_the_true_ones(bed, columns, tasks):
    for number, task in list(enumerate(tasks))[:6]:
        fit = locate(task)[0]
        if fit.matched is None:
            continue
        pose = bed.truth[number]
        for axis, column in fit.matched.pairs:
            foot = task.landmarks.columns.foot_m[column]
            camera = Intrinsics.centred(bed.width_px, bed.height_px, bed.intrinsics.focal_px)
            rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
            middle = foot + np.array([0, 0, 0.5 * HEIGHT_M])
            uv, _ = project(camera, rotation, pose.position_m, middle[None])
            assert abs(uv[0, 0] - camera.cx_px - task.landmarks.axes.middle_px[axis, 0]) < 15.0


def test_no_landmarks_change_nothing(tasks):
    task = tasks[2]
    nothing = replace(task, landmarks=None)
    for a, b in zip(locate(nothing), locate(nothing, NOISE), strict=True):
        assert np.array_equal(a.unknowns, b.unknowns)
    axes = replace(task.landmarks.axes, view=np.ones_like(task.landmarks.axes.view))
    blind = replace(task, landmarks=replace(task.landmarks, axes=axes))
    assert np.array_equal(locate(blind)[0].unknowns, locate(nothing)[0].unknowns)


def test_columns_that_are_elsewhere_are_no_landmarks(bed, columns, tasks):
    rng = np.random.default_rng(1)
    moved = replace(columns, xy_m=columns.xy_m + rng.choice([-1.0, 1.0], columns.xy_m.shape) * 6.0)
    others = list(tasks_of(bed, columns, known=moved))
    wrong = [0 if (m := locate(task)[0].matched) is None else len(m.pairs) for task in others]
    right = [0 if (m := locate(task)[0].matched) is None else len(m.pairs) for task in tasks]
    assert sum(wrong) < 0.35 * sum(right)


@pytest.mark.parametrize("views", [(1, 2), (0, 1)])
def test_bearings_and_slopes_match_differences(tasks, views):
    task = next(t for t in tasks if t.landmarks is not None and len(t.landmarks.axes) > 1)
    columns = np.full(len(task.landmarks.axes), -1)
    columns[:2] = [0, 1]
    scene = task.scene[0], task.origin_m
    matched = match_landmarks(columns, task.landmarks, scene, task.prior_mean)
    seen = matched.observed.copy()
    seen[:, 5] = views
    turn = slopes(task.prior_mean, scene[0], seen, matched.mapped)
    for number in (*range(INSETS), TURNS, TURNS + 1):
        step = np.zeros(len(task.prior_mean))
        step[number] = 1e-5
        up = measure(task.prior_mean + step, scene[0], seen, matched.mapped)
        down = measure(task.prior_mean - step, scene[0], seen, matched.mapped)
        found = (up - down)[:, :3] / 2e-5
        np.testing.assert_allclose(found, turn[:, :, number], rtol=1e-3, atol=1e-6)
    given = seen, matched.mapped, matched.sigma_rad
    cost, normal, gradient, off = landmark_misfit(task.prior_mean, scene[0], *given, 1e6, True)
    assert cost == pytest.approx(0.5 * (off**2).sum(), rel=1e-3)
    by = turn[:, 0] / matched.sigma_rad[:, None]
    np.testing.assert_allclose(normal, by.T @ by, rtol=1e-6)
    np.testing.assert_allclose(gradient, by.T @ off, rtol=1e-6)


def test_beam_finds_what_trying_all_finds(tasks):
    """The likeliest hypothesis among all combinations of admissible pairs."""
    task = max(tasks, key=lambda t: 0 if t.landmarks is None else len(t.landmarks.axes))
    fit = search(task)[0]
    scene, pose = (task.scene[0], task.origin_m), (fit.unknowns, fit.covariance)
    pairs = admissible(task.landmarks, NOISE, scene, pose)
    best = associate(task.landmarks, NOISE, scene, pose)[0]
    options = [[-1, *pairs.column[pairs.axis == a]] for a in range(len(task.landmarks.axes))]
    costs = {}
    for chosen in np.array(np.meshgrid(*options, indexing="ij")).reshape(len(options), -1).T:
        taken = chosen[chosen >= 0]
        if len(set(taken)) < len(taken):
            continue
        rows = [
            np.flatnonzero((pairs.axis == a) & (pairs.column == c))[0]
            for a, c in enumerate(chosen)
            if c >= 0
        ]
        slope, gap, own = pairs.slope[rows], pairs.gap[rows], pairs.variance[rows]
        spread = slope @ pose[1] @ slope.T + np.diag(own)
        axes = [a for a in np.unique(pairs.axis) if chosen[a] < 0]
        cost = 0.5 * gap @ np.linalg.solve(spread, gap) if rows else 0.0
        cost += 0.5 * (np.linalg.slogdet(spread)[1] - np.log(own).sum()) if rows else 0.0
        costs[tuple(chosen)] = cost + pairs.extra[rows].sum() + NOISE.clutter * len(axes)
    assert costs[tuple(best.columns)] == pytest.approx(best.cost, rel=1e-6, abs=1e-9)
    assert best.cost == pytest.approx(min(costs.values()), rel=1e-6, abs=1e-9)


def test_yaw_of_side_views_is_found(bed, columns):
    tasks = list(tasks_of(bed, columns, ("front", "left", "right")))
    images = [(task, locate(task)[0]) for task in tasks]
    turns = side_turns(images, {"left": [-45.0], "right": [36.0, 60.0]}, NOISE)
    for number, yaw in ((1, -SIDE_DEG), (2, SIDE_DEG)):
        assert turns.deg[number] == pytest.approx(yaw, abs=0.15)
        assert abs(turns.deg[number] - yaw) < 4.0 * turns.sigma_deg[number] < 1.0
    far = side_turns(images, {"left": [-90.0]}, NOISE)
    assert np.isinf(far.sigma_deg[1])
    sides = {"side_deg": turns.deg[1:], "side_sigma_deg": turns.sigma_deg[1:]}
    tasks = list(tasks_of(bed, columns, ("front", "left", "right"), **sides))
    with_sides = [locate(task)[0] for task in tasks]
    counts = [0 if fit.matched is None else len(fit.matched.pairs) for fit in with_sides]
    task, fit = tasks[int(np.argmax(counts))], with_sides[int(np.argmax(counts))]
    assert (task.landmarks.axes.view[fit.matched.pairs[:, 0]] > 0).any()
    rest = without_view(task, fit, "left").matched
    assert rest is None or (task.landmarks.axes.view[rest.pairs[:, 0]] != 1).all()
