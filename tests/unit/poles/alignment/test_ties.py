from dataclasses import replace

import numpy as np
import pytest

from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment.drift import OVERLAP, DriftModel
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.epipolar import POSED, shared_misfit
from roadsight.poles.alignment.kernel import camera
from roadsight.poles.alignment.pose import FOCAL, INSETS, SIZE, YAW, Spread, Start, pose_of
from roadsight.poles.alignment.solve import Fit
from roadsight.poles.alignment.ties import (
    LENS,
    Member,
    Normal,
    others_say,
    pose_misfit,
    solve_bordered,
    surprise,
    told_by_others,
)
from roadsight.poles.calibration.calibration import Mount
from roadsight.poles.calibration.calibration_together import Tied, mount_together

WIDTH = 640
HEIGHT = 416
FOCAL_PX = 1650.0
ORIGIN = np.zeros(3)


def start(number, spacing_m=8.0, bend=1 / 300):
    """Places on a bend to the right that rises a little."""
    turn = bend * spacing_m * number
    x, y = (1 - np.cos(turn)) / bend, np.sin(turn) / bend
    middle = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    grade = 0.02, -0.01
    return Start(x, y, 0.1 * number, np.degrees(turn), *grade, WIDTH, HEIGHT, *middle, bend, 0.001)


def unknowns(rng, mean):
    found = mean.copy()
    found[:POSED] += rng.normal(0, [0.5, 0.1, 0.02, 0.3, 0.3, 0.1])
    return found


def mean_unknowns():
    mean = np.zeros(SIZE)
    mean[:7] = 0.2, -0.1, 2.2, 1.0, -1.2, 0.5, np.log(FOCAL_PX)
    return mean


KNOWN = mean_unknowns(), np.zeros((SIZE, SIZE))


def pixels(start, own, points):
    turn, _, centre, _ = camera(start.vector(ORIGIN), own)
    seen = (points - centre) @ turn.T
    return seen[:, :2] / seen[:, 2:] * np.exp(own[FOCAL]) + [start.cx_px, start.cy_px], seen[:, 2]


def shared_points(rng, starts, own, count=120, noise_px=0.3):
    """Pixels of things 20 m to 300 m ahead that both of two cameras show."""
    turn, _, centre, _ = camera(starts[0].vector(ORIGIN), own[0])
    uv = rng.uniform([0, 0], [WIDTH, HEIGHT], (6 * count, 2))
    rays = np.column_stack([(uv - [starts[0].cx_px, starts[0].cy_px]) / FOCAL_PX, np.ones(len(uv))])
    away = np.exp(rng.uniform(np.log(20), np.log(300), len(uv)))
    points = centre + away[:, None] * (rays @ turn)
    there, depth = pixels(starts[1], own[1], points)
    good = (depth > 1) & (there > 0).all(axis=1) & (there < [WIDTH, HEIGHT]).all(axis=1)
    both = np.column_stack([uv, there])[good][:count]
    return both + rng.normal(0, noise_px, both.shape)


def test_exact_points_fit_exactly_and_slopes_are_those_of_small_steps():
    rng = np.random.default_rng(1)
    starts = start(0), start(1)
    own = unknowns(rng, mean_unknowns()), unknowns(rng, mean_unknowns())
    vectors = starts[0].vector(ORIGIN), starts[1].vector(ORIGIN)
    exact = shared_points(rng, starts, own, noise_px=0.0)
    assert np.abs(shared_misfit(own, vectors, exact, 0.4, 3.0)[2]).max() < 1e-6
    off = exact + rng.normal(0, 5.0, exact.shape)
    _, gradient, residuals = shared_misfit(own, vectors, off, 0.4, 1e6)
    for number in range(2 * POSED + LENS):
        step = np.zeros(2 * POSED + LENS)
        step[number] = 1e-5
        moved = own[0].copy(), own[1].copy()
        moved[0][:POSED] += step[:POSED]
        moved[1][:POSED] += step[POSED : 2 * POSED]
        for one in moved:
            one[POSED:INSETS] += step[2 * POSED :]
        later = shared_misfit(moved, vectors, off, 0.4, 1e6)[2]
        slope = (later - residuals) @ residuals / 1e-5
        assert gradient[number] == pytest.approx(slope, rel=1e-2, abs=1e-5 * np.abs(gradient).max())


def test_a_shorter_baseline_fits_no_better():
    """Only its direction tells: residuals stay as they are, and no step along it pays."""
    rng = np.random.default_rng(3)
    starts = tuple(replace(start(k, bend=1e-9), bend=0.0, hump=0.0) for k in (0, 1))
    own = mean_unknowns(), mean_unknowns()
    vectors = starts[0].vector(ORIGIN), starts[1].vector(ORIGIN)
    points = shared_points(rng, starts, own, noise_px=2.0)
    centre1, centre2 = (camera(v, o)[2] for v, o in zip(vectors, own, strict=True))
    along = np.zeros(2 * POSED + LENS)
    moves = camera(vectors[1], own[1])[3]
    along[POSED : POSED + 3] = np.linalg.solve(moves.T, centre2 - centre1)
    normal, gradient, _ = shared_misfit(own, vectors, points, 0.4, 3.0)
    assert abs(gradient @ along) < 1e-6 * np.abs(gradient).max()
    assert along @ normal @ along < 1e-6 * np.abs(normal).max()


def test_points_far_off_do_not_count():
    rng = np.random.default_rng(2)
    starts = start(0), start(1)
    own = mean_unknowns(), mean_unknowns()
    vectors = starts[0].vector(ORIGIN), starts[1].vector(ORIGIN)
    good = shared_points(rng, starts, own)
    wrong = np.vstack([good, good[:40] + np.array([0, 0, 60, 45])])
    one, other = (shared_misfit(own, vectors, p, 0.4, 3.0)[0] for p in (good, wrong))
    np.testing.assert_allclose(one, other, atol=0.02 * np.abs(one).max())


def test_noise_of_points_makes_no_lens_shorter():
    """Of a wide lens, where pixels are smaller angles at the image's sides than in its middle."""
    rng = np.random.default_rng(6)
    own = mean_unknowns()
    own[FOCAL] = np.log(FOCAL_PX / 3)
    place = np.r_[POSED : 2 * POSED, 2 * POSED]
    length_held = np.diag([1e4, *[1e-9] * POSED])
    slope = information = 0.0
    for _ in range(30):
        starts = start(0, spacing_m=13.0), start(1, spacing_m=13.0)
        points = np.column_stack([rng.uniform(-60, 60, 900), rng.uniform(15, 90, 900), 900 * [0.0]])
        points[:, 2] = rng.uniform(-2, 15, 900)
        both = np.column_stack([pixels(one, own, points)[0] for one in starts])
        inside = (both > 0).all(axis=1) & (both < [WIDTH, HEIGHT] * 2).all(axis=1)
        seen = both[inside] + rng.normal(0, 0.4, (inside.sum(), 4))
        vectors = starts[0].vector(ORIGIN), starts[1].vector(ORIGIN)
        normal, gradient, _ = shared_misfit((own, own), vectors, seen, 0.4, 3.0)
        one = normal[np.ix_(place, place)] + length_held
        gain = np.linalg.solve(one[:POSED, :POSED], one[:POSED, POSED])
        information += one[POSED, POSED] - gain @ one[:POSED, POSED]
        slope += gradient[place][POSED] - gain @ gradient[place][:POSED]
    assert abs(slope) < 3.0 * np.sqrt(information)


def random_normal(rng, size, rank):
    rows = rng.normal(size=(rank, size))
    return Normal(rows.T @ rows, rng.normal(size=size))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_what_others_say_is_the_whole_without_one(count):
    """Against one large matrix in which the member's own measurement is left out."""
    rng = np.random.default_rng(count)
    priors = [random_normal(rng, 3, 3) for _ in range(count)]
    own = [random_normal(rng, 3, 2) for _ in range(count)]
    links = [random_normal(rng, 6, 4) for _ in range(count - 1)]
    found = others_say(priors, own, links)
    for left_out in range(count):
        matrix, right = np.zeros((3 * count, 3 * count)), np.zeros(3 * count)
        for k in range(count):
            part = slice(3 * k, 3 * k + 3)
            given = priors[k] if k == left_out else priors[k] + own[k]
            matrix[part, part] += given.matrix
            right[part] += given.right
        for k, link in enumerate(links):
            part = slice(3 * k, 3 * k + 6)
            matrix[part, part] += link.matrix
            right[part] += link.right
        mine = slice(3 * left_out, 3 * left_out + 3)
        mean, covariance = found[left_out].least()
        np.testing.assert_allclose(mean, np.linalg.solve(matrix, right)[mine], rtol=1e-7)
        np.testing.assert_allclose(covariance, np.linalg.inv(matrix)[mine, mine], rtol=1e-7)


def test_no_chain_is_nothing():
    assert others_say([], [], []) == []
    assert told_by_others([], KNOWN, Spread(), DriftModel()) == {}


def test_surprise_counts_sigmas_of_what_was_measured():
    others = Normal(np.diag([4.0, 1.0]), np.zeros(2))
    own = Normal(np.diag([4.0, 0.0]), np.array([4.0 * 3.0, 0.0]))
    assert surprise(own, others) == pytest.approx(9.0 / (0.25 + 0.25))


def test_other_unknowns_are_taken_out():
    """As the lowest misfit over them, at any pose."""
    rng = np.random.default_rng(4)
    data = random_normal(rng, SIZE, SIZE)
    at, mean, rest = rng.normal(size=SIZE), rng.normal(size=SIZE), rng.uniform(0.5, 2, SIZE - POSED)
    given = data.matrix, data.matrix @ at - data.right, at
    found, by_lens = pose_misfit(*given, mean, rest)
    for number in range(LENS):
        other, _ = pose_misfit(*given, mean + np.eye(SIZE)[POSED + number], rest)
        moved = other.right - found.right
        np.testing.assert_allclose(moved, by_lens[:, number], atol=1e-9)
    costs = []
    for pose in rng.normal(size=(3, POSED)):
        inner = data.matrix[POSED:, POSED:] + np.diag(1 / rest)
        tail = data.right[POSED:] + mean[POSED:] / rest - data.matrix[POSED:, :POSED] @ pose
        x = np.r_[pose, np.linalg.solve(inner, tail)]
        whole = 0.5 * x @ data.matrix @ x - data.right @ x
        whole += 0.5 * ((x[POSED:] - mean[POSED:]) ** 2 / rest).sum()
        costs.append(whole - (0.5 * pose @ found.matrix @ pose - found.right @ pose))
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6, atol=1e-6)


def drive(count=12, seed=5, every=3, points_of=shared_points):
    """Members of a drive, of which some measured their poses, and the true unknowns."""
    rng = np.random.default_rng(seed)
    mean = mean_unknowns()
    starts = [start(k) for k in range(count)]
    truth = [unknowns(rng, mean) for _ in range(count)]
    sigma = np.array([0.1, 0.04, 0.03, 0.04, 0.04, 0.1])
    members = []
    for k in range(count):
        measured = None
        if k % every == 0:
            seen = truth[k][:POSED] + rng.normal(0, sigma)
            measured = Normal(np.diag(sigma**-2), sigma**-2 * seen)
        pair = starts[k : k + 2], truth[k : k + 2]
        points = points_of(rng, *pair) if k + 1 < count else np.empty((0, 4))
        place = Place(f"{k}", "r", 8.0 * k, starts[k], np.empty((0, 2)))
        members.append(Member(place, mean, measured, points))
    return members, truth


def heading_errors(members, truth, told):
    found = [
        pose_of(m.place.start, np.r_[told[m.place.image][0], m.unknowns[POSED:]]) for m in members
    ]
    right = [pose_of(m.place.start, t) for m, t in zip(members, truth, strict=True)]
    pairs = zip(found, right, strict=True)
    return np.array([wrap_deg(f.heading_deg - r.heading_deg) for f, r in pairs])


def test_images_that_see_no_pole_have_the_heading_of_their_neighbours():
    members, truth = drive()
    told = told_by_others(members, KNOWN, Spread(yaw_deg=0.3), DriftModel())
    off = heading_errors(members, truth, told)
    sigma = np.array([np.sqrt(told[m.place.image][1][3, 3]) for m in members])
    assert np.abs(off).max() < 0.1
    assert (np.abs(off) < 4 * np.hypot(sigma, 0.02)).all()
    alone = [Member(m.place, m.unknowns, m.measured, np.empty((0, 4))) for m in members]
    untied = told_by_others(alone, KNOWN, Spread(yaw_deg=0.3), DriftModel())
    assert np.median(np.abs(heading_errors(members, truth, untied))) > 0.1


def test_an_image_that_took_a_wrong_pole_is_overruled():
    members, truth = drive()
    wrong = members[6].measured
    shift = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    members[6] = Member(
        members[6].place,
        members[6].unknowns,
        Normal(wrong.matrix, wrong.right + wrong.matrix @ shift),
        members[6].shared,
    )
    told = told_by_others(members, KNOWN, Spread(yaw_deg=0.3), DriftModel())
    assert np.abs(heading_errors(members, truth, told)).max() < 0.1


def far_points(rng, starts, own, band_px=40.0, wrong=0.15, wrong_px=10.0):
    """Pixels of things near the horizon, which hardly tell a turn from a step aside; some wrong."""
    both = shared_points(rng, starts, own, count=1200)
    both = both[np.abs(both[:, 1] - HEIGHT / 2 + 30) < band_px][:120]
    astray = rng.random(len(both)) < wrong
    both[astray, 2:] += rng.normal(0, wrong_px, (astray.sum(), 2))
    return both


def test_neighbours_that_took_a_wrong_pole_are_pulled_back():
    """Five in a row, 17 px off: of 12 drives 7 were torn where links let go at once, now 3."""
    shift = np.array([0.0, 0.2, 0.0, -0.6, 0.0, 0.0])
    off = []
    for seed in range(12):
        members, truth = drive(count=24, seed=seed, every=1, points_of=far_points)
        for k, member in enumerate(members):
            at, measured = truth[k].copy(), member.measured
            if 8 <= k < 13:
                at[:POSED] += shift
                measured = Normal(measured.matrix, measured.right + measured.matrix @ shift)
            members[k] = replace(member, unknowns=at, measured=measured)
        told = told_by_others(members, KNOWN, Spread(yaw_deg=0.3), DriftModel())
        off.append(np.abs(heading_errors(members, truth, told)).max())
    assert np.median(off) < 0.2


def test_an_expectation_does_not_rest_on_the_image_itself():
    members, _ = drive(count=4)
    told = told_by_others(members, KNOWN, Spread(), DriftModel())
    nothing = [
        m if k != 3 else Member(m.place, m.unknowns, None, m.shared) for k, m in enumerate(members)
    ]
    other = told_by_others(nothing, KNOWN, Spread(), DriftModel())
    np.testing.assert_allclose(told["3"][0], other["3"][0], atol=0.02)


def sigmas(told):
    return np.array([np.sqrt(np.diag(own)) for own in (c[:, :POSED] for _, c in told.values())])


def test_a_lens_that_is_off_turns_all_images_by_what_their_covariance_says():
    """Images that measured nothing but the first follow their turns, which the lens scales."""
    members, _ = drive(count=16)
    blind = [replace(m, measured=None) for m in members[1:]]
    off = 0.01
    uncertain = np.zeros((SIZE, SIZE))
    uncertain[FOCAL, FOCAL] = off**2
    swaying = Spread(yaw_deg=5.0)
    mean = mean_unknowns()
    told = told_by_others([members[0], *blind], (mean, uncertain), swaying, DriftModel())
    longer = mean + off * np.eye(SIZE)[FOCAL]
    moved = [replace(m, unknowns=longer) for m in (members[0], *blind)]
    other = told_by_others(moved, (longer, uncertain), swaying, DriftModel())
    turned = np.array([other[m.place.image][0][YAW] - told[m.place.image][0][YAW] for m in blind])
    said = np.array([told[m.place.image][1][YAW, FOCAL] for m in blind]) / off
    assert np.abs(turned).max() > 0.1
    np.testing.assert_allclose(said, turned, atol=0.15 * np.abs(turned).max())
    assert (sigmas(told)[1:, YAW] > 0.9 * np.abs(said)).all()


def test_what_the_drives_mean_leaves_open_stays_open_in_all_its_images():
    """Images that measured nothing look where the mean looks, however many they are."""
    members, _ = drive()
    blind = [Member(m.place, m.unknowns, None, m.shared) for m in members]
    uncertain = np.zeros((SIZE, SIZE))
    uncertain[YAW, YAW] = 0.5**2
    found = told_by_others(blind, (mean_unknowns(), uncertain), Spread(yaw_deg=0.1), DriftModel())
    assert sigmas(found)[:, YAW].min() > 0.45
    certain = told_by_others(blind, KNOWN, Spread(yaw_deg=0.1), DriftModel())
    assert sigmas(certain)[:, YAW].max() < 0.2
    for image, (pose, _) in found.items():
        np.testing.assert_allclose(pose, certain[image][0], atol=1e-9)
    sure = told_by_others(members, (mean_unknowns(), uncertain), Spread(), DriftModel())
    assert sigmas(sure)[:, YAW].max() < 0.2


@pytest.mark.parametrize("count", [1, 2, 6])
def test_a_chain_with_shared_numbers_is_solved_as_one_large_system(count):
    rng = np.random.default_rng(20 + count)
    size, shared = 3, 2
    members = [random_normal(rng, size + shared, 4) for _ in range(count)]
    links = [random_normal(rng, 2 * size + shared, 4) for _ in range(count - 1)]
    border = random_normal(rng, shared, 2)
    whole = size * count + shared
    common = np.arange(size * count, whole)
    matrix, right = np.zeros((whole, whole)), np.zeros(whole)
    parts = [(one, np.r_[size * k : size * (k + 1), common]) for k, one in enumerate(members)]
    parts += [(one, np.r_[size * k : size * (k + 2), common]) for k, one in enumerate(links)]
    for one, place in [*parts, (border, common)]:
        matrix[np.ix_(place, place)] += one.matrix
        right[place] += one.right
    own, found, covariance = solve_bordered(members, links, border)
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(own.ravel(), expected[: size * count], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found, expected[size * count :], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(matrix)[common][:, common], rtol=1e-6)


def tied_drive(count, off):
    """Images that measured their poses but no lens; their lens is taken as longer by a share."""
    members, truth = drive(count)
    sigma = np.array([0.1, 0.04, 0.03, 0.04, 0.04, 0.1])
    normal = np.zeros((SIZE, SIZE))
    normal[:POSED, :POSED] = np.diag(sigma**-2) / OVERLAP
    fits = [
        Fit(at, np.eye(SIZE), 0.0, np.empty((0, 2)), normal, np.zeros(SIZE)) if k % 3 == 0 else None
        for k, at in enumerate(truth)
    ]
    mean = mean_unknowns()
    mean[FOCAL] += off
    members = [replace(m, unknowns=mean, measured=None) for m in members]
    covariance = np.diag(np.r_[1.0, 0.7, 0.5, 3.0, 3.0, 1.5, 0.1, 0.01, [0.2] * 4, 60.0, 60.0] ** 2)
    pairs = zip(members, fits, strict=True)
    return [Tied(member, fit) for member, fit in pairs], Mount(mean, covariance)


def test_a_bend_tells_the_lens_by_what_images_share():
    images, prior = tied_drive(24, off=0.03)
    found = mount_together(images, prior, Spread(), DriftModel())
    sigma = np.sqrt(np.diag(found.covariance))
    error = found.mean - mean_unknowns()
    assert sigma[FOCAL] < 0.005
    assert abs(error[FOCAL]) < 3 * sigma[FOCAL]
    assert abs(error[YAW]) < 3 * sigma[YAW]
    assert found.images == 8
    untied = [replace(one, member=replace(one.member, shared=np.empty((0, 4)))) for one in images]
    alone = mount_together(untied, prior, Spread(), DriftModel())
    assert np.sqrt(alone.covariance[FOCAL, FOCAL]) > 0.09


def test_a_lens_that_is_known_is_held():
    images, prior = tied_drive(12, off=0.0)
    known = prior.covariance.copy()
    known[FOCAL, FOCAL] = 1e-8
    found = mount_together(images, replace(prior, covariance=known), Spread(), DriftModel())
    assert found.mean[FOCAL] == pytest.approx(np.log(FOCAL_PX), abs=3e-4)


def test_an_image_that_the_others_contradict_hardly_moves_the_mount():
    images, prior = tied_drive(24, off=0.0)
    right = mount_together(images, prior, Spread(), DriftModel())
    wrong = images[12].fit.unknowns + 5.0 * np.eye(SIZE)[YAW]
    images[12] = replace(images[12], fit=replace(images[12].fit, unknowns=wrong))
    found = mount_together(images, prior, Spread(), DriftModel())
    assert abs(found.mean[YAW] - right.mean[YAW]) < 0.1
    assert abs(found.mean[FOCAL] - right.mean[FOCAL]) < 0.005
