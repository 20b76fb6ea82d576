from dataclasses import replace

import numpy as np
import pytest

from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg
from roadsight.poles.alignment.drive import near_edges, places_of
from roadsight.poles.alignment.pose import SIZE, YAW, Spread, Start, pose_of
from roadsight.poles.alignment.roadside import NearEdges, RoadEdges
from roadsight.poles.alignment.solve import ImageEdges, Noise, Task, descend, search
from roadsight.poles.alignment.verdict import (
    Limits,
    condition,
    doubt,
    edge_sigma_px,
    is_one_sided,
    reached,
    sigmas,
    too_little,
)
from roadsight.stages.poles.align_cameras import aligned
from tests.helpers.road_bed import Mount, RoadBed, frames_of

MOUNT = Mount()
INFORMATION = np.diag(1.0 / Spread(along_m=0.3).vector() ** 2)


def expected(bed):
    """The drive's true mean."""
    m = bed.mount
    angles = [m.yaw_deg, m.pitch_deg, m.roll_deg - 1.146]
    lens = np.log(bed.intrinsics.focal_px)
    return np.array([0, m.lateral_m, m.height_m, *angles, lens, 0.0, 0.5, 0.5, *[0.0] * 4])


def tasks_of(bed, pixels=None, information=INFORMATION):
    edges = RoadEdges.from_points(bed.road_edges)
    for place, rows in zip(places_of(frames_of(bed), edges), pixels or bed.seen, strict=True):
        seen = ImageEdges.from_pixels(rows[:, :2], rows[:, 2], rows[:, 3] > 0.5)
        map_edges = near_edges(place, edges, Reach())
        yield Task(place.start, seen, map_edges, Noise(), expected(bed), information)


@pytest.fixture(scope="module")
def bed():
    return RoadBed(seed=5, images=14, gps_m=0.3)


@pytest.fixture(scope="module")
def tasks(bed):
    return list(tasks_of(bed))


@pytest.fixture(scope="module")
def fits(tasks):
    return [search(task) for task in tasks]


def test_poses_are_right_and_sigmas_honest(bed, tasks, fits):
    errors = []
    for truth, task, fit in zip(bed.truth, tasks, fits, strict=True):
        pose = pose_of(task.start, fit[0].unknowns)
        heading = float(wrap_deg(pose.heading_deg - truth.heading_deg))
        turn = np.radians(truth.heading_deg)
        gap = pose.position_m - truth.position_m
        lateral = gap[0] * np.cos(turn) - gap[1] * np.sin(turn)
        sigma = sigmas(fit[0], task)
        pitch = pose.pitch_deg - truth.pitch_deg
        errors.append([heading, pitch, lateral, heading / sigma[0], lateral / sigma[2]])
    errors = np.abs(errors)
    assert np.mean(errors[:, 0] < 0.1) >= 0.9
    assert np.median(errors[:, 1]) < 0.05 and np.median(errors[:, 2]) < 0.06
    assert (errors[:, 3:] < 3.0).all()
    assert all(doubt(t, f, Limits()) == "" for t, f in zip(tasks, fits, strict=True))


def ending(task, fit, reach_m):
    """The same image at the end of a cloud, expected where its neighbours have it."""
    away = np.hypot(*(task.map_edges.xyz_m[:, :2] - task.origin_m[:2]).T)
    kept = away <= reach_m
    left = int(kept[: task.map_edges.left].sum())
    edges = task.map_edges
    parts = edges.xyz_m[kept], edges.along[kept], edges.inward[kept], edges.half_m[kept]
    expected = fit.unknowns, 400.0 * INFORMATION
    return Task(task.start, task.image_edges, NearEdges(*parts, left), task.noise, *expected)


@pytest.mark.parametrize("reach_m", [25.0, 60.0])
def test_road_beyond_the_end_of_the_cloud_contradicts_nothing(tasks, fits, reach_m):
    """Half of an image's edges and more may lie where the cloud has none."""
    beyond = []
    for task, fit in zip(tasks, fits, strict=True):
        short = ending(task, fit[0], reach_m)
        found = search(short)
        beyond.append(1.0 - reached(short, found[0]).mean())
        assert doubt(short, found, Limits()) == ""
        assert reached(task, fit[0]).mean() > 0.85
    assert max(beyond) > {25.0: 0.3, 60.0: 0.0}[reach_m]


def beside(task, yaw_deg):
    """The same image, surely expected to look elsewhere."""
    mean = task.prior_mean.copy()
    mean[YAW] += yaw_deg
    return replace(task, prior_mean=mean, prior_information=25.0 * INFORMATION)


def test_the_end_of_a_cloud_does_not_decide_by_what_was_expected(tasks, fits):
    """So near an end nothing is left to judge by, and a border missing on one side is no end."""
    for task, fit in zip(tasks[1:13], fits[1:13], strict=True):
        short = beside(ending(task, fit[0], 15.0), 1.0)
        assert doubt(short, search(short), Limits()) != ""
        edges = task.map_edges
        away = np.hypot(*(edges.xyz_m[:, :2] - task.origin_m[:2]).T)
        kept = (np.arange(len(away)) < edges.left) | (away < 6.0)
        parts = edges.xyz_m[kept], edges.along[kept], edges.inward[kept], edges.half_m[kept]
        half = replace(ending(task, fit[0], 1e9), map_edges=NearEdges(*parts, edges.left))
        assert reached(half, fit[0]).mean() > 0.85


def test_edges_that_contradict_the_end_of_a_cloud_are_refused(tasks, fits):
    """As far as the cloud reaches, edges must agree, and enough of them."""
    short = ending(tasks[3], fits[3][0], 25.0)
    moved = replace(short.image_edges, uv_px=short.image_edges.uv_px + np.array([90.0, 0.0]))
    wrong = replace(short, image_edges=moved)
    assert doubt(wrong, [descend(wrong, wrong.prior_mean, 3.0)], Limits()) != ""
    found = search(short)
    more = replace(Limits(), fewest_pixels=int(reached(short, found[0]).sum()) + 1)
    assert "in the cloud" in doubt(short, found, more)


def test_limits_are_wider_by_what_a_sparse_cloud_adds_alone(tasks, fits):
    assert edge_sigma_px(fits[3][0], tasks[3]) == 0.0
    sparse = [replace(task, noise=Noise.of_spacing(0.7)) for task in tasks[3:6]]
    added = [edge_sigma_px(search(task)[0], task) for task in sparse]
    # 0.14 m instead of 0.03 and 0.1 m, some 20 m away: pixels, of images 1000 px wide.
    assert all(1.0 < one < 10.0 for one in added)


def test_derivatives_match_differences(tasks, fits):
    task = tasks[3]
    noise = Noise(1.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    at = fits[3][0].unknowns + 0.01
    off = np.abs(task.evaluate(at, 3.0)[3])
    near = (off < 3.0).all(axis=1)
    group = np.repeat(np.arange(4), np.diff(task.image_edges.groups))[near]
    few = ImageEdges.from_pixels(
        task.image_edges.uv_px[near], np.where(group % 2, 1, -1), group < 2
    )
    task = replace(task, image_edges=few, noise=noise, prior_information=np.eye(SIZE) * 1e-12)
    _, _, gradient, _ = task.evaluate(at, 1e6)
    for number in range(SIZE):
        step = np.zeros(SIZE)
        step[number] = 1e-6
        _, _, _, up = task.evaluate(at + step, 1e6)
        _, _, _, down = task.evaluate(at - step, 1e6)
        _, _, _, here = task.evaluate(at, 1e6)
        same = np.abs(up[:, 0] - down[:, 0]) < 0.2  # the nearest point has not changed
        slope = ((up[:, 0] - down[:, 0]) / 2e-6 * here[:, 0])[same].sum()
        assert same.mean() > 0.95
        assert slope == pytest.approx(gradient[number], rel=0.15, abs=0.02 * np.abs(gradient).max())


def test_distances_match_a_slow_reference(tasks):
    task = tasks[2]
    unknowns = task.prior_mean.copy()
    unknowns[7:] = 0.0
    pose = pose_of(task.start, unknowns)
    camera = Intrinsics.centred(task.start.width_px, task.start.height_px, pose.focal_px)
    rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
    uv, depth = project(camera, rotation, pose.position_m, task.map_edges.xyz_m)
    ahead, _ = project(
        camera, rotation, pose.position_m, task.map_edges.xyz_m + 1e-5 * task.map_edges.along
    )
    residuals = task.evaluate(unknowns, 3.0)[3]
    side = np.arange(len(uv)) >= task.map_edges.left
    group = np.repeat(np.arange(4), np.diff(task.image_edges.groups))
    for i, pixel in enumerate(task.image_edges.uv_px):
        usable = (side == group[i] % 2) & (depth >= 1.0)
        j = np.flatnonzero(usable)[np.argmin(np.hypot(*(uv[usable] - pixel).T))]
        tangent = (ahead[j] - uv[j]) / np.linalg.norm(ahead[j] - uv[j])
        across = tangent[1] * (pixel - uv[j])[0] - tangent[0] * (pixel - uv[j])[1]
        assert residuals[i, 0] == pytest.approx(across, rel=1e-3, abs=1e-2)


def moved(task, angle_rad, shift_m):
    """The same image elsewhere, the world turned anticlockwise about its vertical."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    at = np.array([task.start.x_m, task.start.y_m, task.start.z_road_m]) @ turn + shift_m
    heading = task.start.heading_deg - np.degrees(angle_rad)
    start = replace(task.start, x_m=at[0], y_m=at[1], z_road_m=at[2], heading_deg=heading)
    e = task.map_edges
    map_edges = NearEdges(
        e.xyz_m @ turn + shift_m, e.along @ turn, e.inward @ turn, e.half_m, e.left
    )
    return replace(task, start=start, map_edges=map_edges)


@pytest.mark.parametrize("angle_rad, shift", [(0.0, 5e6), (2.1, 0.0), (-1.0, 3e6)])
def test_the_frame_does_not_matter(tasks, fits, angle_rad, shift):
    for number in (1, 6):
        other = search(moved(tasks[number], angle_rad, np.array([shift, -shift, 0.0])))
        gap = np.abs(other[0].unknowns - fits[number][0].unknowns)
        assert (gap < 0.05 * np.sqrt(np.diag(fits[number][0].covariance))).all()


def test_left_and_right_are_alike(tasks):
    """A world seen in a mirror: yaw, roll, lateral place and bend change their sign."""
    task = tasks[4]
    flip = np.array([-1.0, 1.0, 1.0])
    e, s = task.map_edges, task.start
    order = np.concatenate([np.arange(e.left, len(e.half_m)), np.arange(e.left)])
    map_edges = NearEdges(
        e.xyz_m[order] * flip, e.along[order] * flip, e.inward[order] * flip, e.half_m[order],
        len(order) - e.left,
    )  # fmt: skip
    start = replace(s, x_m=-s.x_m, heading_deg=-s.heading_deg, bank=-s.bank, bend=-s.bend)
    group = np.repeat(np.arange(4), np.diff(task.image_edges.groups))
    uv = task.image_edges.uv_px * [-1, 1] + [task.start.width_px - 1, 0]
    seen = ImageEdges.from_pixels(uv, np.where(group % 2, -1, 1), group < 2)
    sign = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1, 1, 1, 1, -1, -1.0])
    swap = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8, 11, 10, 13, 12]
    mirrored = Task(
        start, seen, map_edges, task.noise, task.prior_mean[swap] * sign, task.prior_information
    )
    near = descend(mirrored, mirrored.prior_mean, 8.0).unknowns[swap] * sign
    direct = descend(task, task.prior_mean, 8.0)
    gap = np.abs(near - direct.unknowns) / np.sqrt(np.diag(direct.covariance))
    assert gap.max() < 0.3


def test_order_of_pixels_does_not_matter(bed, fits, rng):
    shuffled = [rng.permutation(rows) for rows in bed.seen]
    for fit, task in list(zip(fits, tasks_of(bed, shuffled), strict=True))[:3]:
        assert np.array_equal(search(task)[0].unknowns, fit[0].unknowns)


def test_nothing_to_see_keeps_the_expected_pose(bed, tasks):
    empty = ImageEdges.from_pixels(np.empty((0, 2)), [], [])
    row = aligned(replace(tasks[0], image_edges=empty), "road", Limits())
    assert not row["accepted"] and row["reason"] == "too few edges in the image"
    pose = pose_of(tasks[0].start, tasks[0].prior_mean)
    assert (row["x"], row["heading_deg"]) == (pose.x_m, pose.heading_deg)
    nowhere = NearEdges(*(np.empty((0, 3)) for _ in range(3)), np.empty(0), 0)
    assert too_little(replace(tasks[0], map_edges=nowhere), Limits()) == "too few road edges ahead"


def test_a_pose_carries_its_condition_number(bed, tasks, fits):
    empty = ImageEdges.from_pixels(np.empty((0, 2)), [], [])
    unaligned = aligned(replace(tasks[0], image_edges=empty), "road", Limits())
    assert unaligned["condition"] == pytest.approx(1.0)
    found = [condition(fit[0], task) for fit, task in zip(fits, tasks, strict=True)]
    assert min(found) > 10 and np.isfinite(found).all()


def test_everything_behind_the_camera_is_refused(tasks):
    start = replace(tasks[0].start, heading_deg=tasks[0].start.heading_deg + 180.0)
    row = aligned(replace(tasks[0], start=start), "road", Limits())
    assert not row["accepted"]
    assert np.isfinite([row["x"], row["heading_deg"], row["sigma_heading_deg"]]).all()


def test_other_edges_are_refused(bed, tasks, rng):
    """Edge pixels of something else altogether."""
    for task in tasks[:4]:
        uv = rng.uniform([0, 0], [bed.width_px, bed.height_px], (600, 2))
        seen = ImageEdges.from_pixels(uv, rng.choice([-1, 1], 600), rng.random(600) < 0.5)
        assert not aligned(replace(task, image_edges=seen), "road", Limits())["accepted"]


def test_one_side_alone_is_known_and_less_certain(bed, tasks, fits):
    rows = [part[part[:, 2] > 0] for part in bed.seen]
    for number, task in list(enumerate(tasks_of(bed, rows)))[:3]:
        assert is_one_sided(task) and not is_one_sided(tasks[number])
        both = np.diag(fits[number][0].covariance)
        assert np.diag(search(task)[0].covariance)[1] > both[1]


def test_pose_of_a_level_road():
    start = Start(10.0, 20.0, 5.0, 90.0, 0.0, 0.0, 100, 80, 49.5, 39.5)
    pose = pose_of(start, np.array([2.0, 1.0, 1.5, 3.0, -1.0, 0.5, np.log(80.0), 0, 0, 0, 0]))
    np.testing.assert_allclose(pose.position_m, [12.0, 19.0, 6.5], atol=1e-9)
    assert (pose.heading_deg, pose.focal_px) == (pytest.approx(93.0), pytest.approx(80.0))
