from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.geometry.cameras import Intrinsics, wrap_deg
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.landmarks import MatchedLandmarks, landmark_misfit
from roadsight.poles.alignment.pose import CX, FOCAL, PITCH, SIZE, YAW, Start
from roadsight.poles.alignment.solve import FINEST, Fit
from roadsight.poles.alignment.ties import Member
from roadsight.poles.alignment.verdict import moved_by_centre, moved_by_focal
from roadsight.poles.calibration.calibration import (
    Mount,
    apart_from_centre,
    no_surer,
    weak_mount,
    with_centre_held,
    with_centre_open,
)
from roadsight.poles.calibration.calibration_together import (
    Tied,
    centre_doubts,
    lens_sigmas,
    told_centre,
)
from roadsight.poles.sightings.sighting_bearing import ViewCamera, image_bearings, turned_by_camera

START = Start(100.0, 200.0, 5.0, 30.0, 0.0, 0.0, 1000, 600, 499.5, 299.5)
PRIOR_PX = 15.0
BENT_PX = 0.3 / np.tan(np.radians(30.0)) ** 2
"""What a lens of 60 degrees may still bend, as a shift of its principal point."""


def random_covariance(seed):
    root = np.random.default_rng(seed).normal(size=(SIZE, SIZE))
    return root @ root.T + 0.1 * np.eye(SIZE)


def image(rng, places, number=0):
    """An image that shows columns at some of the places (k, 2), as local metres."""
    pose = with_centre_held(weak_mount(60.0, START.width_px)).mean
    mapped = np.column_stack([places - [START.x_m, START.y_m], np.zeros(len(places))])
    mapped = np.column_stack([mapped, mapped[:, 2] + 4.0])
    observed = np.zeros((len(places), 7))
    observed[:, 0], observed[:, 4] = rng.uniform(-400, 400, len(places)), 1.0
    pairs = np.column_stack([np.arange(len(places))] * 2)
    matched = MatchedLandmarks(pairs, observed, mapped, np.full(len(places), 0.003))
    normal, gradient = misfit_of(pose, matched)
    edges = np.diag(rng.uniform(1, 2, SIZE)), rng.normal(size=SIZE)
    fit = Fit(
        pose, np.eye(SIZE), 0.0, np.empty((0, 2)), normal + edges[0], gradient + edges[1], matched,
        normal, gradient,
    )  # fmt: skip
    place = Place(str(number), "route", 8.0 * number, START, np.empty((0, 2)))
    return Tied(Member(place, pose, None, np.empty((0, 4))), fit), edges


def misfit_of(pose, matched):
    vector = START.vector(np.array([START.x_m, START.y_m, START.z_road_m]))
    numbers = matched.observed, matched.mapped, matched.sigma_rad
    return landmark_misfit(pose, vector, *numbers, FINEST, True)[1:3]


@given(st.integers(0, 10_000))
def test_a_covariance_is_that_for_a_known_point_and_what_the_point_moves(seed):
    covariance = random_covariance(seed)
    known, by_centre = apart_from_centre(covariance)
    assert by_centre[CX] ** 2 == pytest.approx(covariance[CX, CX])
    rest = np.arange(SIZE) != CX
    whole = known + np.outer(by_centre, by_centre)
    np.testing.assert_allclose(whole[rest][:, rest], covariance[rest][:, rest], atol=1e-9)
    information = np.linalg.inv(covariance)[np.ix_(rest, rest)]
    np.testing.assert_allclose(known[np.ix_(rest, rest)], np.linalg.inv(information), atol=1e-6)


def test_holding_a_point_keeps_what_the_middle_shows():
    mount = weak_mount(60.0, 1000)
    mount.mean[[YAW, CX]] = 2.0, 40.0
    held = with_centre_held(mount)
    focal_px = np.exp(mount.mean[FOCAL])
    # The middle of the image lies left of a point that is off to the right.
    seen_deg = 2.0 + np.degrees(np.arctan((0.0 - 40.0) / focal_px))
    assert held.mean[CX] == 0.0
    assert held.mean[YAW] == pytest.approx(seen_deg)


@given(st.integers(0, 10_000), st.floats(0.0, 100.0))
def test_opening_never_makes_surer_and_keeps_what_the_middle_shows(seed, sigma_px):
    mount = Mount(weak_mount(60.0, 1000).mean, random_covariance(seed))
    opened = with_centre_open(mount, sigma_px).covariance
    assert np.linalg.eigvalsh(opened - mount.covariance).min() > -1e-9
    before = np.sqrt(mount.covariance[CX, CX])
    assert np.sqrt(opened[CX, CX]) == pytest.approx(max(sigma_px, before))
    held = with_centre_held(mount)
    opened = with_centre_open(held, sigma_px).covariance
    middle = np.zeros(SIZE)
    middle[[YAW, CX]] = 1.0, -np.degrees(np.exp(-held.mean[FOCAL]))
    here, there = (middle @ c @ middle for c in (held.covariance, opened))
    assert there == pytest.approx(here, rel=1e-6)


def test_what_the_point_moves_in_an_image_is_the_move_of_its_minimum():
    rng = np.random.default_rng(1)
    known, by_centre = apart_from_centre(random_covariance(1))
    information = np.linalg.inv(known)
    task = SimpleNamespace(prior_information=information)
    data = random_covariance(2)
    fit = Fit(np.zeros(SIZE), np.eye(SIZE), 0.0, np.empty((0, 2)), data, rng.normal(size=SIZE))
    rest = np.arange(SIZE) != CX

    def least(centre_px):
        """Of data and expectation over all but the point, by one dense solution."""
        expected = by_centre[rest] * centre_px / by_centre[CX]
        inner = information[np.ix_(rest, rest)]
        right = inner @ expected - fit.gradient[rest] - data[rest, CX] * centre_px
        return np.linalg.solve(inner + data[np.ix_(rest, rest)], right)

    moved = moved_by_centre(fit, task, by_centre)
    np.testing.assert_allclose(moved[rest], least(by_centre[CX]) - least(0.0), atol=1e-9)
    assert moved[CX] == by_centre[CX]


def test_another_focal_length_moves_an_image_as_if_it_were_solved_for_it():
    """By the conditional minimum of the quadratic misfit whose inverse the covariance is."""
    covariance = random_covariance(3)
    fit = Fit(np.zeros(SIZE), covariance, 0.0, np.empty((0, 2)), np.eye(SIZE), np.zeros(SIZE))
    moved, rest = moved_by_focal(fit), np.arange(SIZE) != FOCAL
    assert moved[FOCAL] == pytest.approx(np.sqrt(covariance[FOCAL, FOCAL]))
    normal = np.linalg.inv(covariance)
    held = np.linalg.solve(normal[np.ix_(rest, rest)], -normal[rest, FOCAL] * moved[FOCAL])
    np.testing.assert_allclose(moved[rest], held)


def test_bearings_carry_the_point_only_as_far_as_the_heading_does_not_undo_it():
    focal, sigma_px = 600.0, 6.0
    turns = float(np.degrees(sigma_px / focal))
    lens = Intrinsics(1000, 600, focal, 499.5, 299.5)
    camera = ViewCamera(
        lens, (0.0, 0.0, 2.0), 20.0, sigma_heading_deg=float(np.hypot(turns, 0.02)),
        sigma_cx_px=sigma_px, heading_by_cx_deg=turns,
    )  # fmt: skip
    uv = np.column_stack([np.array([499.5, 300.0, 10.0]), np.full(3, 299.5)])
    bearing, sigma = image_bearings(camera, uv, 0.0)
    assert sigma[0] == pytest.approx(0.02, rel=0.01)
    moved = replace(
        camera, intrinsics=replace(lens, cx_px=499.5 + sigma_px), heading_deg=20.0 + turns
    )
    off = wrap_deg(image_bearings(moved, uv, 0.0)[0] - bearing)
    np.testing.assert_allclose(sigma, np.hypot(off, 0.02), rtol=0.05, atol=1e-4)
    assert sigma[2] > sigma[1] > sigma[0]


def test_a_focal_length_turns_what_is_left_and_right_of_the_middle_apart():
    """As another camera sees it whose focal length and heading are off by one sigma together."""
    lens = Intrinsics(1000, 600, 600.0, 499.5, 299.5)
    lens_off = replace(lens, focal_px=600.0 * 1.005)
    camera = ViewCamera(
        lens, (0.0, 0.0, 2.0), 20.0, sigma_heading_deg=float(np.hypot(0.03, 0.04)),
        sigma_focal_ratio=0.005, heading_by_focal_deg=0.03,
    )  # fmt: skip
    uv = np.column_stack([np.array([10.0, 499.5, 900.0]), np.full(3, 299.5)])
    bearing, sigma = image_bearings(camera, uv, 0.0)
    moved = replace(camera, intrinsics=lens_off, heading_deg=20.03)
    off = wrap_deg(image_bearings(moved, uv, 0.0)[0] - bearing)
    by_cx, by_focal, by_heading = turned_by_camera(camera, uv).T
    np.testing.assert_allclose(by_focal, off, rtol=0.02)
    assert by_focal[0] > 0.03 > by_focal[2]
    assert not by_cx.any()
    np.testing.assert_allclose(by_heading, 0.04)
    np.testing.assert_allclose(sigma, np.hypot(by_focal, 0.04))


PLACES = np.column_stack([np.linspace(80, 140, 12), 200 + np.linspace(20, 90, 12)])


def solver(effects, formal_px):
    """Stands for the solution of a drive: each column draws the point by as much."""
    tables = {tuple(np.round(place, 2)): e for place, e in zip(PLACES, effects, strict=True)}

    def solve(images, prior):
        seen = {
            tuple(np.round(np.add(row[:2], [START.x_m, START.y_m]), 2))
            for one in images
            if one.fit is not None
            for row in one.fit.matched.mapped
        }
        mean, covariance = prior.mean.copy(), prior.covariance.copy()
        mean[CX] = np.mean([tables[place] for place in sorted(seen)] or [0.0])
        covariance[CX], covariance[:, CX] = 0.0, 0.0
        covariance[CX, CX] = formal_px**2
        return Mount(mean, covariance)

    return solve


def drive(rng, count=4):
    return [image(rng, PLACES, number)[0] for number in range(count)]


def test_the_points_sigma_is_what_columns_that_all_images_share_make_it():
    """Many images of columns that are off by themselves do not average their errors out."""
    rng = np.random.default_rng(3)
    prior = with_centre_held(weak_mount(60.0, 1000))
    found = []
    for _ in range(200):
        solve = solver(rng.normal(0, 6.0, len(PLACES)), 0.3)
        images = drive(rng)
        found.append(lens_sigmas(images, solve(images, prior), prior, solve)[0])
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(
        np.hypot(6.0 / np.sqrt(12), BENT_PX), rel=0.1
    )
    solve = solver(np.zeros(len(PLACES)), 0.3)
    images = drive(rng)
    assert lens_sigmas(images, solve(images, prior), prior, solve)[0] == pytest.approx(
        np.hypot(0.3, BENT_PX)
    )


def test_few_columns_tell_nothing_of_the_point():
    rng = np.random.default_rng(5)
    one, _ = image(rng, PLACES[:4], 0)
    free = with_centre_open(with_centre_held(weak_mount(60.0, 1000)), PRIOR_PX)
    point_px, _ = lens_sigmas([one], free, free, solver(np.zeros(len(PLACES)), 0.3))
    assert point_px == pytest.approx(PRIOR_PX)


@pytest.mark.parametrize("count", [4, 12])
def test_a_focal_length_is_no_surer_than_stretches_and_columns_agree_on_it(count):
    """Stretches of a drive, and columns, that each draw it by 1 % leave what their mean leaves."""
    rng = np.random.default_rng(6)
    prior = with_centre_held(weak_mount(60.0, 1000))
    prior.covariance[FOCAL, FOCAL] = 0.001**2
    places = PLACES[:count]
    found = []
    for _ in range(200):
        by_column = dict(zip(map(tuple, places), rng.normal(0, 0.01, count), strict=True))
        by_image = rng.normal(0, 0.01, 12)

        def solve(images, prior, by_column=by_column, by_image=by_image):
            seen = {
                tuple(np.round(np.add(row[:2], [START.x_m, START.y_m]), 2))
                for one in images
                if one.fit is not None
                for row in one.fit.matched.mapped
            }
            told = [e for place, e in by_column.items() if tuple(np.round(place, 2)) in seen]
            said = [by_image[n] for n, one in enumerate(images) if one.fit is not None]
            mean = prior.mean.copy()
            mean[FOCAL] = np.mean(told) + np.mean(said)
            return replace(prior, mean=mean)

        images = [image(rng, places, number)[0] for number in range(12)]
        found.append(lens_sigmas(images, solve(images, prior), prior, solve)[1])
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(0.01 / np.sqrt(12), rel=0.3)
    held = replace(prior, covariance=prior.covariance.copy())
    # Rounding leaves the point not quite in the middle; what goes with it must not blow that up.
    held.covariance[CX, FOCAL] = held.covariance[FOCAL, CX] = 1e-7
    told, _ = told_centre(images, held, prior, PRIOR_PX, solve)
    assert np.sqrt(told.covariance[FOCAL, FOCAL]) == pytest.approx(found[-1])
    assert np.sqrt(told.covariance[CX, CX]) == pytest.approx(PRIOR_PX, rel=0.01)


def test_what_is_no_surer_takes_along_what_goes_with_it():
    """Its sigma is as said, what goes with it follows, and less is never made of it."""
    covariance = random_covariance(8)
    mount = Mount(np.zeros(SIZE), covariance, 5)
    sigma = np.sqrt(covariance[FOCAL, FOCAL])
    wider = no_surer(mount, FOCAL, 3.0 * sigma)
    np.testing.assert_allclose(wider.covariance[FOCAL], 9.0 * covariance[FOCAL])
    rest = np.delete(np.arange(SIZE), FOCAL)

    def known(c):
        return (c - np.outer(c[FOCAL], c[FOCAL]) / c[FOCAL, FOCAL])[np.ix_(rest, rest)]

    np.testing.assert_allclose(known(wider.covariance), known(covariance), atol=1e-9)
    np.testing.assert_allclose(no_surer(mount, FOCAL, 0.5 * sigma).covariance, covariance)


@pytest.mark.parametrize("off_px", [-12.0, 0.0, 1.0, 12.0])
def test_a_point_that_is_not_clearly_off_the_middle_stays_there(off_px):
    rng = np.random.default_rng(4)
    held = with_centre_held(weak_mount(60.0, 1000))
    solve = solver(np.full(len(PLACES), off_px), 2.0)
    mount, told = told_centre(drive(rng), held, held, PRIOR_PX, solve)
    sigma_px = np.sqrt(mount.covariance[CX, CX])
    assert told == (abs(off_px) > 5.0)
    assert mount.mean[CX] == (off_px if told else 0.0)
    own_px = np.hypot(2.0, BENT_PX)
    assert sigma_px == pytest.approx(own_px if told else np.hypot(own_px, off_px))
    assert mount.mean[PITCH] == held.mean[PITCH]


def test_only_a_point_that_is_open_and_matters_is_told():
    held = with_centre_held(weak_mount(60.0, 1000))
    held.mean[CX] = 2e-4  # rounding
    (told,) = centre_doubts("route", with_centre_open(held, 8.0))
    assert told.measured == 8.0
    assert "0.5 degrees" in told.message
    assert not centre_doubts("route", with_centre_open(held, 1.0))
    off = held.mean.copy()
    off[CX] = 12.0
    assert not centre_doubts("route", replace(with_centre_open(held, 8.0), mean=off))


def test_an_image_without_a_column_is_as_if_it_had_never_been_paired():
    rng = np.random.default_rng(5)
    one, edges = image(rng, PLACES)
    seen = []

    def solve(images, prior):
        if images[0].fit is not None:
            seen.append(images[0].fit)
        return prior

    prior = with_centre_open(with_centre_held(weak_mount(60.0, 1000)), PRIOR_PX)
    lens_sigmas([one], prior, prior, solve)
    paired = [fit for fit in seen if len(fit.matched.pairs) < len(PLACES)]
    assert len(paired) == 6
    for fit in paired:
        assert len(fit.matched.pairs) == 10
        normal, gradient = misfit_of(fit.unknowns, fit.matched)
        np.testing.assert_allclose(fit.normal, normal + edges[0], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(fit.gradient, gradient + edges[1], rtol=1e-6, atol=1e-6)
