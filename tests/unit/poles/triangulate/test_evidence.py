import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp, minimize
from scipy.stats import norm

from roadsight.poles.triangulate.association import (
    BIN_M,
    Grower,
    Work,
    choose,
    evidence,
    find_neighbours,
    in_order,
    misfit,
    settle,
    speaks,
)
from roadsight.poles.triangulate.explain import associate, explain_rays, likelihood
from roadsight.poles.triangulate.noise import (
    RayNoise,
    fit_noise,
    misfits,
    place_groups,
    stated_noise,
)
from roadsight.poles.triangulate.rays import UNAIDED, make_rays
from tests.helpers.drives import Drive, on_road, rays_and_poles, simulate

CHOICE = UNAIDED
WORLDS = {
    "straight": Drive(),
    "bent": Drive(bend_m=150.0, strays=0.15),
    "dense": Drive(gap_m=9.0, step_m=5.0),
    "sparse": Drive(gap_m=35.0, step_m=12.0, strays=0.1),
    "precise": Drive(place_m=0.25, turn_deg=0.6, depth=0.12),
    "rough": Drive(place_m=1.2, turn_deg=2.5, depth=0.3, bend_m=200.0),
    "hidden feet": Drive(hidden=0.15, depth=0.1),
}
"""Of another simulator than the one in view when constants were chosen; only the share of shared
errors was chosen with these too, on other seeds."""


def model_of(rows, choice=CHOICE):
    rays, own = rays_and_poles(rows)
    near = find_neighbours(rays, choice)
    return rays, own, near, likelihood(rays, near, [], stated_noise(choice), choice)


@pytest.fixture(scope="module")
def street():
    return model_of(simulate(Drive(poles=12, strays=0.2), 5)[1])


def slow_misfit(rays, model, place, i):
    """Chi squared and density of a ray by SciPy's normal densities."""
    gap = place - rays.camera_m[i]
    r = np.hypot(*gap)
    turn = np.degrees(np.arctan2(*gap)) - rays.bearing_deg[i]
    turn = np.radians((turn + 180.0) % 360.0 - 180.0)
    sigmas = np.hypot([model.angle_sigma[i], model.log_sigma[i]], model.place_sigma[i] / r)
    rests = np.array([turn, np.log(r) - model.log_depth[i]])
    return float(((rests / sigmas) ** 2).sum()), float(norm.logpdf(rests, 0.0, sigmas).sum())


def test_misfit_is_that_of_normal_errors(street):
    rays, _, _, model = street
    for i in range(0, len(rays), 3):
        for shift in ([0.0, 0.0], [1.0, -2.0]):
            place = rays.camera_m[i] + rays.depth_m[i] * rays.direction[i] + shift
            chi2, density, r = misfit(model, *place, i, np.inf)
            assert (chi2, density) == pytest.approx(slow_misfit(rays, model, place, i))
            assert r == pytest.approx(np.hypot(*(place - rays.camera_m[i])))


def test_rays_behind_and_out_of_reach_say_nothing(street):
    rays, _, _, model = street
    behind = rays.camera_m[0] - 5.0 * rays.direction[0]
    far = rays.camera_m[0] + (CHOICE.max_distance_m + 1) * rays.direction[0]
    for place in (behind, far, rays.camera_m[0] + 0.1 * rays.direction[0]):
        assert speaks(model, *place, 0, np.inf) == -np.inf


def test_settled_place_is_the_likeliest_and_its_covariance_the_curvature(street):
    rays, own, _, model = street
    for pole in range(0, 12, 2):
        members = np.flatnonzero(own == pole)
        if len(members) < 2:
            continue
        start = rays.camera_m[members[0]] + rays.depth_m[members[0]] * rays.direction[members[0]]
        x, y, half = settle(model, *start, members)

        def cost(place, members=members):
            return 0.5 * sum(slow_misfit(rays, model, place, i)[0] for i in members)

        best = minimize(cost, [x, y], method="Nelder-Mead", options={"xatol": 1e-6}).x
        # The kernel keeps the errors of the camera's place as they are at the last step.
        assert np.hypot(*(best - [x, y])) < 0.35 * np.exp(0.5 * half)
        assert cost((x, y)) < cost(best) + 0.1


def test_chosen_members_are_the_loudest_of_each_image(street):
    rays, _, near, model = street
    free = np.ones(len(rays), bool)
    free[::7] = False
    for seed in range(0, len(rays), 5):
        x, y = rays.camera_m[seed] + rays.depth_m[seed] * rays.direction[seed]
        members, count = choose(model, x, y, near.of(seed), free, False)
        slow = []
        for image in sorted(set(rays.image[near.of(seed)].tolist())):
            same = [i for i in near.of(seed) if rays.image[i] == image and free[i]]
            said = [speaks(model, x, y, i, 1.0) for i in same]
            if said and max(said) > 0:
                slow.append(same[int(np.argmax(said))])
        assert members[:count].tolist() == slow


def test_evidence_is_the_sum_of_what_images_say(street):
    rays, own, near, model = street
    members = np.flatnonzero(own == 3)
    x, y, half = settle(model, *simulate(Drive(poles=12, strays=0.2), 5)[0][3], members)
    seed = int(members[0])
    expected = model.new_pole + np.log(2 * np.pi) + half
    for image in set(rays.image[near.of(seed)].tolist()):
        same = [i for i in near.of(seed) if rays.image[i] == image]
        away = np.hypot(*(rays.camera_m[same[0]] - [x, y]))
        if away > model.reach_m:
            continue
        missed = model.missed[int(away / BIN_M)]
        shown = np.log1p(-np.exp(missed))
        mine = [i for i in same if i in members]
        if mine:
            expected += slow_misfit(rays, model, np.array([x, y]), mine[0])[1]
            expected += shown - model.stray[mine[0]]
        else:
            expected += missed
    assert evidence(model, x, y, half, members, near.of(seed)) == pytest.approx(expected)


def every_group(rays, grower):
    """All groups of two to four rays of different images, with their evidence."""
    found = []
    for size in (2, 3, 4):
        for members in itertools.combinations(range(len(rays)), size):
            if len(set(rays.image[list(members)].tolist())) < size:
                continue
            i = members[0]
            start = rays.camera_m[i] + rays.depth_m[i] * rays.direction[i]
            pole = grower.fit(np.array(members), *start, i)
            if pole is not None:
                found.append(pole)
    return found


@pytest.mark.parametrize("seed", range(6))
def test_poles_explain_small_streets_as_well_as_the_best_of_all_choices(seed):
    drive = Drive(poles=4, gap_m=11.0, step_m=9.0, strays=0.2, shown=0.8)
    rays, _, near, model = model_of(simulate(drive, seed)[1][:14])
    grower = Grower(rays, near, model)
    everything = every_group(rays, grower)
    gain = np.array([pole.gain for pole in everything])
    ray_in_group = np.array([np.isin(np.arange(len(rays)), p.members) for p in everything]).T
    once = LinearConstraint(ray_in_group, -np.inf, 1)  # each ray shows one pole at most
    best = -milp(-gain, integrality=np.ones(len(gain)), bounds=Bounds(0, 1), constraints=once).fun
    ours = associate(grower)
    # Exchange does not split three rays into two pairs; it lists longer groups than the choice.
    assert sum(pole.gain for pole in ours) >= 0.9 * best
    taken = np.concatenate([pole.members for pole in ours])
    assert len(set(taken.tolist())) == len(taken)
    assert ours == in_order(ours)


def test_views_of_one_pole_are_one_pole():
    pole = np.array([20.0, 6.0])
    camera = np.column_stack([np.arange(0.0, 40.0, 8.0), np.zeros(5)])
    gap = pole - camera
    rays = make_rays(camera, np.degrees(np.arctan2(*gap.T)), np.hypot(*gap.T), image=np.arange(5))
    found = explain_rays(rays, CHOICE)
    assert [group.tolist() for group in found.groups] == [[0, 1, 2, 3, 4]]
    assert found.place_m[0] == pytest.approx(pole, abs=1e-6)


def test_no_rays_and_one_ray_are_no_pole():
    for count in (0, 1):
        rays = make_rays(np.zeros((count, 2)), np.zeros(count), np.full(count, 9.0))
        found = explain_rays(rays, CHOICE)
        assert found.groups == []
        assert found.place_m.shape == (0, 2)
        assert found.scale == 1.0


@pytest.mark.parametrize("name", WORLDS)
def test_poles_are_found_and_few_are_made_up(name):
    found = seen = near = 0
    for seed in (101, 102):
        poles, rows = simulate(WORLDS[name], seed)
        shown = np.unique(rows[rows[:, 5] >= 0, 5].astype(int))
        answer = explain_rays(rays_and_poles(rows)[0], CHOICE)
        gap = np.hypot(*(answer.place_m[:, None] - poles[shown][None]).transpose(2, 0, 1))
        found, seen = found + len(answer.groups), seen + len(shown)
        near += int((gap.min(axis=0) < 4.0).sum())
    assert found <= 1.08 * seen
    assert near >= (0.75 if name == "sparse" else 0.9) * seen


def inside(drive, seeds, choice=CHOICE):
    """Chi squared of places whose rays show mostly one pole."""
    values = []
    for seed in seeds:
        poles, rows = simulate(drive, seed)
        rays, own = rays_and_poles(rows)
        answer = explain_rays(rays, choice)
        for group, place, covariance in zip(
            answer.groups, answer.place_m, answer.covariance, strict=True
        ):
            counts = np.bincount(own[group] + 1, minlength=len(poles) + 1)[1:]
            if 2 * counts.max() > len(group):
                off = place - poles[counts.argmax()]
                values.append(off @ np.linalg.solve(covariance, off))
    return np.array(values)


def test_error_ellipses_hold_what_they_say():
    chi2 = np.concatenate([inside(drive, (401, 402, 501)) for drive in WORLDS.values()])
    assert len(chi2) > 600
    assert 0.35 <= (chi2 <= 1.0).mean() <= 0.45
    assert 0.92 <= (chi2 <= 5.99).mean() <= 0.98


def test_a_drift_that_is_stated_is_in_the_ellipses():
    """It leaves no misfit: what a whole neighbourhood shares must be stated."""
    drive = Drive(place_m=0.2, drift_m=1.5)
    stated = UNAIDED.model_copy(update={"sigma_position_m": 1.5, "shared_variance": 0.9})
    unstated = UNAIDED
    with_it, without = (inside(drive, (301, 302), choice) for choice in (stated, unstated))
    assert (with_it <= 5.99).mean() >= 0.85
    assert (without <= 5.99).mean() < (with_it <= 5.99).mean()


def test_errors_are_found_from_the_rays():
    drive = Drive(poles=150, place_m=0.4, turn_deg=0.7, depth=0.15)
    poles, rows = simulate(drive, 8)
    rays, own = rays_and_poles(rows)
    groups = [np.flatnonzero(own == n) for n in range(len(poles))]
    kept = [n for n, group in enumerate(groups) if len(group) > 1]
    noise = fit_noise(rays, [groups[n] for n in kept], poles[kept], CHOICE)
    assert noise.position_m == pytest.approx(0.4, rel=0.3)
    assert noise.depth_ratio == pytest.approx(0.15, rel=0.3)
    assert np.degrees(noise.bearing_rad) == pytest.approx(0.7, rel=0.8)


def slow_place(rays, members, place, noise, choice):
    """Generalised least squares of one group, written out with a loop over pairs of rays."""
    size, share = len(members), choice.shared_variance
    rest, covariance = np.zeros(2 * size), np.zeros((2 * size, 2 * size))
    frames = []
    for k, i in enumerate(members):
        gap = place - rays.camera_m[i]
        r = np.hypot(*gap)
        ahead = gap / r
        side = np.array([ahead[1], -ahead[0]])
        turn = np.radians(rays.bearing_deg[i]) - np.arctan2(*gap)
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        rest[2 * k : 2 * k + 2] = r * turn * side + r * np.log(rays.depth_m[i] / r) * ahead
        frames.append((r * side, r * ahead))
    v = noise.variances
    for k, i in enumerate(members):
        for m, j in enumerate(members):
            apart = np.hypot(*(rays.camera_m[i] - rays.camera_m[j]))
            same = float(k == m)
            block = (v[0] * same + v[1] * np.exp(-apart / 100.0)) * np.eye(2)
            block += (v[2] * same + v[3] * np.exp(-apart / 30.0)) * np.outer(
                frames[k][0], frames[m][0]
            )
            block += (v[4] * same + v[5]) * np.outer(frames[k][1], frames[m][1])
            covariance[2 * k : 2 * k + 2, 2 * m : 2 * m + 2] = block
    assert 0 < share < 1
    design = np.tile(np.eye(2), (size, 1))
    weights = np.linalg.inv(covariance + 1e-6 * np.eye(2 * size))
    normal = design.T @ weights @ design
    return place + np.linalg.solve(normal, design.T @ weights @ rest), np.linalg.inv(normal)


def test_places_agree_with_least_squares_written_out():
    poles, rows = simulate(Drive(poles=6), 4)
    rays, own = rays_and_poles(rows)
    noise = stated_noise(CHOICE)
    for pole in range(6):
        members = np.flatnonzero(own == pole)
        place = poles[pole]
        for _ in range(3):
            place, covariance = slow_place(rays, members, place, noise, CHOICE)
        ours, spread = place_groups(rays, [members], poles[[pole]], noise, CHOICE)
        assert ours[0] == pytest.approx(place)
        assert spread[0] == pytest.approx(covariance)


def test_misfits_of_equal_groups_do_not_depend_on_their_neighbours():
    poles, rows = simulate(Drive(poles=6), 4)
    rays, own = rays_and_poles(rows)
    kept = [pole for pole in range(6) if (own == pole).sum() >= 2]
    groups = np.stack([np.flatnonzero(own == pole)[:2] for pole in kept])
    together = misfits(rays, groups, poles[kept], CHOICE)
    for n in range(len(kept)):
        alone = misfits(rays, groups[[n]], poles[kept][[n]], CHOICE)
        assert (alone.parts[:, 0] == together.parts[:, n]).all()
        assert (alone.rest_m[0] == together.rest_m[n]).all()


def test_views_of_one_column_do_not_average_its_error_out():
    pole = np.array([20.0, 6.0])
    sigmas = []
    for count in (2, 12):
        camera = np.column_stack([np.linspace(0.0, 15.0, count), np.zeros(count)])
        gap = pole - camera
        away = np.hypot(*gap.T)
        turn = np.degrees(0.1 / away)
        columns = {"image": np.arange(count), "anchored": np.ones(count, bool)}
        bearing = np.degrees(np.arctan2(*gap.T))
        rays = make_rays(camera, bearing, away, turn, np.full(count, 0.1), **columns)
        spread = explain_rays(rays, CHOICE).covariance[0]
        sigmas.append(float(np.sqrt(np.linalg.eigvalsh(spread)[1])))
    np.testing.assert_allclose(sigmas, 0.1, rtol=0.02)


@pytest.mark.parametrize("column_m", [0.03, 0.15])
def test_ellipses_of_poles_at_columns_are_as_wide_as_their_errors(column_m, rng):
    """A column that is off for all images that end at it, each with a bearing of its own."""
    squared = []
    for _ in range(600):
        count = int(rng.integers(2, 9))
        pole = np.array([rng.uniform(10.0, 20.0), rng.uniform(4.0, 9.0)])
        camera = np.column_stack([np.linspace(0.0, 8.0, count), np.zeros(count)])
        gap = pole + rng.normal(0.0, column_m, 2) - camera
        away = np.hypot(*gap.T)
        image, ends = np.full(count, np.radians(0.2)), column_m / away
        turn = np.arctan2(*(pole - camera).T) + image * rng.normal(size=count)
        share = image**2 / (image**2 + ends**2)
        turn += share * (np.arctan2(*gap.T) - turn)
        sigma = np.degrees(image * np.sqrt(1.0 - share))
        columns = {"image": np.arange(count), "anchored": np.ones(count, bool)}
        rays = make_rays(camera, np.degrees(turn), away, sigma, np.full(count, column_m), **columns)
        found = place_groups(rays, [np.arange(count)], pole[None], stated_noise(CHOICE), CHOICE)
        off = found[0][0] - pole
        squared.append(off @ np.linalg.solve(found[1][0], off))
    within = [np.mean(np.array(squared) < limit) for limit in (1.0, 5.99)]
    assert 0.35 < within[0] < 0.45
    assert 0.92 < within[1] < 0.98


def test_hidden_feet_are_found_although_depths_are_stated_precise():
    poles, rows = simulate(Drive(poles=80, hidden=0.25, depth=0.04), 9)
    rays, own = rays_and_poles(rows)
    rays = replace(rays, sigma_depth_m=0.05 * rays.depth_m)
    groups = [np.flatnonzero(own == n) for n in range(len(poles))]
    kept = [n for n, group in enumerate(groups) if len(group) > 2]
    noise = fit_noise(rays, [groups[n] for n in kept], poles[kept], CHOICE)
    assert 0.12 < noise.hidden_ratio < 0.4


def test_anchored_depths_are_not_scaled():
    rays = make_rays([[0, 0], [8, 0]], [30, 330], [10, 10], image=[0, 1], anchored=[True, False])
    assert rays.scaled(2.0).depth_m.tolist() == [10.0, 20.0]


def test_work_grows_with_the_number_of_rays_only():
    """Counted, not timed: pairs that are tried and rays that are looked at.

    A short street takes fewer turns, and its ends have fewer neighbours.
    """
    counts = []
    for poles in (150, 450):
        rows = simulate(Drive(poles=poles, strays=0.2), 6)[1]
        work = Work()
        explain_rays(rays_and_poles(rows)[0], CHOICE, work)
        counts.append(np.array([work.pairs, work.looks]) / len(rows))
    assert (counts[1] < 1.35 * counts[0]).all()


def test_noise_only_widens_when_asked():
    low, high = RayNoise(np.arange(1.0, 7.0)), RayNoise(np.arange(6.0, 0.0, -1.0))
    assert low.or_wider(high).variances.tolist() == [6, 5, 4, 4, 5, 6]


def test_bent_road_is_as_long_as_it_says():
    drive = Drive(bend_m=100.0)
    places = on_road(drive, np.array([0.0, 1.0]), np.zeros(2))
    assert np.hypot(*(places[1] - places[0])) == pytest.approx(1.0, rel=1e-4)
