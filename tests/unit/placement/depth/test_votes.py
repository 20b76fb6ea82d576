import numpy as np
import pytest

from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.depth.votes import (
    View,
    VoteSettings,
    _agree,
    _box,
    _bucket,
    _cone,
    _count,
    _first_layer,
    _gather,
    _narrower,
    seen_from_here,
)
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import Sensor
from roadsight.scene.samples import Samples, build_samples
from roadsight.scene.surfels import build_surfels
from roadsight.scene.voxel_planes import coarsen, sum_moments

AT = np.array([0.0, 0.0, 0.0])
SENSOR = Sensor(
    azimuth_step_deg=0.5, elevation_min_deg=-20, elevation_max_deg=4, channels=61, range_m=60
)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def scanned(ranges_of, rng, beams=400_000, noise=0.01):
    """Returns of a scanner at the origin in a scene given by its ranges along directions."""
    azimuth, sine = rng.uniform(-np.pi, np.pi, beams), rng.uniform(-0.35, 0.1, beams)
    level = np.sqrt(1 - sine**2)
    d = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), sine])
    r = ranges_of(d, rng)
    hit = np.isfinite(r)
    return d[hit] * (r[hit] + rng.normal(0, noise, hit.sum()))[:, None]


def room(d, _rng):
    """Ground 1.7 m below and a ring of wall 20 m away."""
    with np.errstate(divide="ignore"):
        ground = np.where(d[:, 2] < 0, -1.7 / d[:, 2], np.inf)
        wall = 20 / np.hypot(d[:, 0], d[:, 1])
    return np.minimum(ground, wall)


def hedged(share):
    """The room with a hedge ring, 12 to 12.6 m away, that stops a share of the beams."""

    def ranges(d, rng):
        stopped = rng.random(len(d)) < share
        hedge = rng.uniform(12, 12.6, len(d)) / np.hypot(d[:, 0], d[:, 1])
        return np.where(stopped, np.minimum(hedge, room(d, rng)), room(d, rng))

    return ranges


def lidar(points):
    fine = sum_moments(points, 0.05)
    return SurfelLidar(build_surfels(coarsen(fine)), build_samples(fine))


def exact(sensor):
    return room(beam_directions(sensor, 0.0).reshape(-1, 3).astype(float), None)


def test_beams_go_through_a_sparse_hedge_and_stop_at_a_dense_one(rng):
    d = beam_directions(SENSOR, 0.0).reshape(-1, 3).astype(float)
    through = room(d, None) > 13
    for share, passes in ((0.2, True), (0.8, False)):
        points = scanned(hedged(share), rng)
        depth = lidar(points).depth_map(SENSOR, AT, 0.0).ravel()
        right = np.abs(depth - room(d, None)) < 0.5 if passes else np.abs(depth - 12.3) < 0.9
        assert right[through].mean() > 0.9
    first = SurfelLidar(build_surfels(sum_moments(scanned(hedged(0.2), rng), 0.1)))
    stopped = first.depth_map(SENSOR, AT, 0.0).ravel()[through] < 13
    assert stopped.mean() > 0.3


def test_grazing_ground_and_walls_are_met_on_their_planes(rng):
    depth = lidar(scanned(room, rng)).depth_map(SENSOR, AT, 0.0).ravel()
    assert (np.abs(depth - exact(SENSOR)) < 0.2).mean() > 0.98


def test_nothing_returns_far_from_all_samples(rng):
    points = scanned(room, rng)
    up = np.column_stack([np.zeros(50), np.sin(np.linspace(0.3, 1.5, 50)), np.ones(50)])
    up /= np.linalg.norm(up, axis=1)[:, None]
    assert np.isinf(lidar(points).cast(AT, up, 60.0)).all()


def test_only_a_cloud_scanned_from_here_votes(rng):
    samples = build_samples(sum_moments(scanned(room, rng), 0.05))
    even = np.column_stack([rng.uniform(-30, 30, (300_000, 2)), rng.normal(-1.7, 0.01, 300_000)])
    assert seen_from_here(samples, AT, 60.0, VoteSettings())
    everywhere = build_samples(sum_moments(even, 0.05))
    assert not seen_from_here(everywhere, AT, 60.0, VoteSettings())
    surfels = build_surfels(sum_moments(even, 0.1))
    both = SurfelLidar(surfels, everywhere).depth_map(SENSOR, AT, 0.0)
    assert (both == SurfelLidar(surfels).depth_map(SENSOR, AT, 0.0)).all()


@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_points_vote_for_nothing_and_break_nothing(n):
    points = np.arange(3 * n, dtype=float).reshape(-1, 3) + 5
    depth = lidar(points).depth_map(SENSOR, AT, 0.0)
    assert depth.shape == SENSOR.shape
    assert np.isfinite(depth).all()


def test_far_sparse_points_elsewhere_change_nothing_near(rng):
    near = scanned(room, rng)
    far = np.column_stack([rng.uniform(200, 900, (30_000, 2)), rng.normal(0, 0.3, 30_000)])
    alone = lidar(near).depth_map(SENSOR, AT, 0.0)
    with_far = lidar(np.concatenate([near, far])).depth_map(SENSOR, AT, 0.0)
    assert (np.abs(alone - with_far) < 0.01).mean() > 0.999


def test_one_ray_alone_is_that_ray_among_others(rng):
    it = lidar(scanned(hedged(0.4), rng))
    d = beam_directions(SENSOR, 0.0).reshape(-1, 3)
    whole = it.cast(AT, d, 60.0)
    rows = rng.choice(len(d), 20, replace=False)
    assert [it.cast(AT, d[row], 60.0)[0] for row in rows] == whole[rows].tolist()
    origins = np.where(np.arange(20)[:, None] % 2 == 0, AT, AT + np.array([0.2, 0.0, 0.0]))
    mixed = it.cast(origins, d[rows], 60.0)
    assert (mixed[::2] == whole[rows[::2]]).all()


def view_of(rng, n=4000):
    """A view of lone samples, and its parts."""
    xyz = rng.normal(size=(n, 3)) * [20, 20, 8]
    view = View(build_samples(sum_moments(xyz, 0.05)), AT, 90.0, VoteSettings())
    return view, view._seen, view._starts, view._buckets


def test_gather_finds_what_brute_force_finds(rng):
    _, seen, starts, buckets = view_of(rng)
    directions = np.concatenate([rng.normal(size=(60, 3)), np.eye(3), -np.eye(3)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for d in directions.astype(np.float32):
        for radius in (0.003, 0.02, 0.1):
            found, gap2 = np.empty(5000, np.int64), np.empty(5000)
            n = _gather(d, seen, starts, *buckets, radius, found, gap2)
            expected = ((seen[:, :3].astype(float) - d) ** 2).sum(axis=1)
            inside = np.flatnonzero(expected < radius**2)
            assert abs(n - len(inside)) <= (np.abs(expected - radius**2) < 1e-7).sum()
            assert len(set(found[:n].tolist()) ^ set(inside.tolist())) <= abs(n - len(inside))


def test_counts_and_agreement_equal_brute_force(rng):
    view, seen, starts, (columns, rows) = view_of(rng)
    place = np.array([_bucket(*row[:3], columns, rows) for row in seen.astype(float)])
    place = np.minimum(place.astype(int), [columns - 1, rows - 1])
    for d in seen[rng.choice(len(seen), 60), :3]:
        box = _box(d, columns, rows, 0.02)
        low, high, first, last = box
        wrapped = np.arange(first, last + 1) % columns
        inside = (place[:, 1] >= low) & (place[:, 1] <= high) & np.isin(place[:, 0], wrapped)
        assert _count(starts, columns, *box) == inside.sum()
        middle = float(np.median(seen[inside, 3]))
        agreed = _agree(starts, view._least, view._most, columns, box, middle, 5.0, 3)
        assert agreed == (inside.sum() >= 3 and np.abs(seen[inside, 3] - middle).max() <= 5.0)


def test_cones_hold_about_the_voters(rng):
    d = rng.normal(size=(400_000, 3)) * [1, 1, 0.3]
    xyz = 10 * d / np.linalg.norm(d, axis=1)[:, None]
    view = View(build_samples(sum_moments(xyz, 0.05)), AT, 90.0, VoteSettings())
    seen, starts, buckets = view._seen, view._starts, view._buckets
    counts = []
    for towards in seen[rng.choice(len(seen), 300), :3]:
        radius = _cone(towards, starts, *buckets, 16, 0.0026, 0.0175)
        found, gap2 = np.empty(500, np.int64), np.empty(500)
        counts.append(_gather(towards, seen, starts, *buckets, radius, found, gap2))
    assert 10 <= np.median(counts) <= 32


def slow_first_layer(t, weight, stops, near, layer_m):
    """The rule, window by window."""
    windows = [np.flatnonzero((t >= a) & (t <= a + 2 * layer_m)) for a in t]
    touching = [k for k, w in enumerate(windows) if (near[w] <= 0).any()]
    if not touching:
        return np.inf
    best = max(weight[windows[k]].sum() for k in touching)
    first = next(k for k in touching if stops[windows[k]].sum() >= best * (1 - 1e-9))
    rivals = [k for k in touching if k >= first and t[k] <= t[first] + layer_m]
    chosen = windows[max(rivals, key=lambda k: (weight[windows[k]].sum(), -k))]
    return (weight[chosen] * t[chosen]).sum() / weight[chosen].sum()


def test_the_first_layer_is_that_of_the_slow_rule(rng):
    for _ in range(500):
        n = rng.integers(1, 20)
        t, weight = np.sort(rng.uniform(5, 12, n)), rng.uniform(0.1, 3, n)
        stops, near = weight * rng.uniform(1, 2, n), rng.normal(0.3, 1, n)
        fast = _first_layer(t, weight, stops, near, n, 0.5)
        assert fast == pytest.approx(slow_first_layer(t, weight, stops, near, 0.5))


def test_samples_hold_every_point_at_every_size(rng):
    points = rng.normal(size=(5000, 3)) * 10
    samples = build_samples(sum_moments(points, 0.05))
    assert isinstance(samples, Samples)
    for row in samples.starts:
        part = slice(row[0], row[-1])
        assert samples.points[part].sum() == 5000
        mean = np.average(samples.xyz_m[part], axis=0, weights=samples.points[part])
        np.testing.assert_allclose(mean, points.mean(axis=0), atol=1e-3)


def test_samples_lie_near_their_planes(rng):
    xy = rng.uniform(-3, 3, (20_000, 2))
    z = xy @ [0.2, 0.1] + rng.normal(0, 0.01, 20_000)
    samples = build_samples(sum_moments(np.column_stack([xy, z]), 0.05))
    normal = np.array([-0.2, -0.1, 1]) / np.linalg.norm([0.2, 0.1, 1])
    inner = np.abs(samples.xyz_m[:, :2]).max(axis=1) < 2.5
    on_plane = samples.xyz_m + samples.offset_m[:, None] * samples.normal
    assert np.abs(on_plane[inner] @ normal).max() < 0.02
    assert np.median(samples.spread_m[inner]) == pytest.approx(0.01, rel=0.25)


def test_fewer_vote_where_a_cone_is_wide(rng):
    """At twice the range at which their number begins to fall, half of the samples vote."""
    n, far = 400, 40.0
    gap2 = np.append(rng.uniform(0, 1e-4, n - 1), 1e-9)
    seen = np.full((n, 12), far, np.float32)
    found, before = np.arange(n), gap2.copy()
    kept, radius = _narrower(seen, found, gap2, n, 0.01, far / 2)
    assert radius == pytest.approx(0.01 / np.sqrt(2))
    np.testing.assert_array_equal(found[:kept], np.flatnonzero(before < radius**2))
    np.testing.assert_array_equal(gap2[:kept], before[before < radius**2])
    assert _narrower(seen, found, gap2, n, 0.01, far) == (n, 0.01)
    apart = np.full(n, 0.9e-4)
    assert _narrower(seen, found, apart, n, 0.01, far / 2) == (n, 0.01)
    assert _narrower(seen, found, gap2, 0, 0.01, far / 2) == (0, 0.01)
