import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from roadsight.base.errors import InputError
from roadsight.poles.risk.cross_sections import (
    LEAST_SIGMA_M,
    Profile,
    binned_profile,
    cross_section,
    fit_pieces,
    noise_of,
    profile_from_heights,
    profile_from_points,
    slope_text,
    steepest,
)
from roadsight_worlds.rural.rural_road import build_rural
from tests.helpers.rural_sections import (
    edge_and_outward,
    exact_height,
    ground_points,
    open_stations,
    true_hinges,
)

NAMES = ("shoulder", "foreslope", "ditch bottom", "backslope")
RUN = np.arange(0, 8.05, 0.1)


def bent(*corners):
    return np.interp(RUN, *np.array(corners, float).T)


def section_of(heights, sigma_m=None):
    return cross_section(binned_profile(RUN, heights, 0.1, sigma_m))


def differences(section, hinges, slopes):
    """Errors of slopes, slopes in sigmas, and hinge places, of the four named elements."""
    rows = []
    for number, (kind, slope) in enumerate(zip(NAMES, slopes, strict=False)):
        own = max((e for e in section.elements if e.kind == kind), key=lambda e: e.width_m)
        rows.append(
            (
                own.slope - slope,
                (own.slope - slope) / own.sigma_slope,
                own.end_m - hinges[number + 1],
            )
        )
    return np.abs(rows)


@pytest.mark.parametrize(("many", "share"), [(1, 1.06), (3, 0.72), (20, 0.237), (60, 0.137)])
def test_a_bin_knows_as_much_as_its_heights(many, share, rng):
    run = np.repeat(np.arange(0.05, 100, 0.1), many)
    found = binned_profile(run, rng.normal(0, 0.03, len(run)), 0.1, 0.03)
    # The mean of n normal heights has sigma 1 / sqrt(n), the median a quarter more.
    assert found.height_m.std() < 0.03 * share
    noise = np.sqrt(found.sigma_m**2 - LEAST_SIGMA_M**2)
    assert (found.height_m / noise).std() == pytest.approx(1.0, abs=0.12)


def test_grass_and_stones_are_no_ground(rng):
    run = np.repeat(np.arange(0.05, 50, 0.1), 20)
    height = rng.normal(0, 0.03, len(run))
    grown = np.tile(np.arange(20) < 3, 500)
    found = binned_profile(run, np.where(grown, height + 0.4, height), 0.1, 0.03)
    assert abs(found.height_m.mean()) < 0.003


@pytest.fixture(scope="module", params=[1, 3])
def site(request):
    return build_rural(request.param, 200.0, detail=0.01)


def test_exact_sections_are_found_again(site):
    hinges, slopes = true_hinges(site)
    for side in (-1, 1):
        for station in open_stations(site, side):
            edge, outward = edge_and_outward(site, station, side)
            section = cross_section(profile_from_heights(edge, outward, exact_height(site), 8.0))
            errors = differences(section, hinges, slopes)
            assert errors[:, 0].max() < 0.01
            assert errors[:, 2].max() < 0.05
            assert section.fall[0] == pytest.approx(slopes[1], abs=0.005)
            assert section.foreslope()[0] < -1 / 3  # the ditch that one straight line hides


def test_sections_of_scanned_ground_and_their_sigmas(site):
    rng = np.random.default_rng(4)
    points = ground_points(site, rng, (0.0, site.length_m), per_m2=20, sigma_m=0.02)
    tree, (hinges, slopes) = cKDTree(points[:, :2]), true_hinges(site)
    found = np.array(
        [
            differences(
                cross_section(
                    profile_from_points(*edge_and_outward(site, s, side), points, 8.0, tree=tree)
                ),
                hinges,
                slopes,
            )
            for side in (-1, 1)
            for s in open_stations(site, side, 5.0)
        ]
    )
    assert found[:, [0, 1, 3], 0].max() < 0.02
    assert found[:, 2, 0].max() < 0.035  # 0.7 m of ditch bottom
    assert found[:, :, 2].max() < 0.15
    # Sigmas are neither boasts nor covers.
    assert 0.4 < np.sqrt((found[:, :, 1] ** 2).mean()) < 1.3


def ditch(run_m):
    """Heights of a ditch with a bottom of 0.7 m that falls by 3 %."""
    return np.interp(run_m, [0, 1.2, 2.7, 3.4, 5.0, 8.0], [0, -0.06, -0.71, -0.731, -0.131, -0.1])


def strip_points(rng, along_m, height, per_m2=20, sigma_m=0.028):
    """Ground points (n, 3) beside an edge along y, between two places along it."""
    count = rng.poisson(per_m2 * 8.0 * (along_m[1] - along_m[0]))
    run, along = rng.uniform(0, 8.0, count), rng.uniform(*along_m, count)
    return np.column_stack([run, along, height(run) + rng.normal(0, sigma_m, count)])


EDGE, OUTWARD = np.zeros(2), np.array([1.0, 0.0])


def bottom(points):
    section = cross_section(profile_from_points(EDGE, OUTWARD, points, 8.0))
    return next(e for e in section.elements if e.kind == "ditch bottom")


def test_strips_alike_tell_the_slope_of_a_narrow_bottom(rng):
    """Three metres either way hold 90 points of it, 15 mm of slope at best; twelve hold 360."""
    found = [bottom(strip_points(rng, (-12.0, 12.0), ditch)) for _ in range(40)]
    off = np.array([element.slope + 0.03 for element in found])
    assert np.quantile(np.abs(off), 0.95) < 0.022
    sigma = np.array([element.sigma_slope for element in found])
    assert 0.4 < np.sqrt(((off / sigma) ** 2).mean()) < 1.4


def test_strips_that_a_bend_moves_aside_are_alike(rng):
    strips = []
    for low in np.arange(-12.0, 12.0, 1.0):
        aside = (low + 0.5) ** 2 / (2 * 200.0)
        strips.append(strip_points(rng, (low, low + 1.0), lambda run, a=aside: ditch(run - a)))
    section = cross_section(profile_from_points(EDGE, OUTWARD, np.concatenate(strips), 8.0))
    hinges = [e.end_m for e in section.elements[:4]]
    assert hinges == pytest.approx([1.2, 2.7, 3.4, 5.0], abs=0.12)


@pytest.mark.parametrize(
    "beside",
    [lambda run: -0.02 * run, lambda run: ditch(run) - 0.6 * (run > 2.4)],
    ids=["driveway", "culvert"],
)
def test_strips_with_another_section_are_left_out(rng, beside):
    near = strip_points(rng, (-3.0, 3.0), ditch)
    far = [strip_points(rng, along, beside) for along in ((-12.0, -3.0), (3.0, 12.0))]
    alone = profile_from_points(EDGE, OUTWARD, near, 8.0)
    both = profile_from_points(EDGE, OUTWARD, np.concatenate([near, *far]), 8.0)
    assert both.run_m == pytest.approx(alone.run_m)
    assert both.height_m == pytest.approx(alone.height_m)


@pytest.mark.parametrize(("jump", "kind"), [(0.12, "kerb"), (-0.08, "drop-off"), (0.8, "wall")])
@pytest.mark.parametrize("sigma_m", [0.0, 0.005])
def test_steps_are_told_from_slopes(jump, kind, sigma_m, rng):
    heights = bent((0, 0), (9, -0.2)) + np.where(RUN > 1.04, jump, 0.0)
    section = section_of(heights + rng.normal(0, sigma_m, len(RUN)))
    (step,) = section.steps()
    assert step.kind == kind
    assert step.rise_m == pytest.approx(jump, abs=0.02)
    assert step.start_m == pytest.approx(1.05, abs=0.1)
    assert not [e for e in section.elements if e.kind in ("foreslope", "backslope")]


def test_a_v_ditch_and_an_embankment():
    ditch = section_of(bent((0, 0), (1.5, -0.06), (3.5, -0.56), (6, 0.44), (8.1, 0.5)))
    kinds = [e.kind for e in ditch.elements]
    assert kinds == ["shoulder", "foreslope", "backslope", "level"]
    assert ditch.foreslope()[0] == pytest.approx(-0.25, abs=0.01)
    assert ditch.backslope()[0] == pytest.approx(0.4, abs=0.01)
    bank = section_of(bent((0, 0), (1, -0.04), (8.1, -3.59)))
    assert [e.kind for e in bank.elements] == ["shoulder", "foreslope"]
    assert slope_text(bank.elements[1].slope) == "1V:2.0H"


def test_level_ground_is_no_shoulder_and_no_slope():
    section = section_of(-0.02 * RUN)
    assert [e.kind for e in section.elements] == ["level"]
    assert np.isnan(section.foreslope()[1])
    assert section.foreslope()[0] == 0
    assert section.fall[0] == pytest.approx(-0.02, abs=1e-6)


def test_a_compound_foreslope_keeps_its_steep_part():
    section = section_of(bent((0, 0), (1, -0.04), (3, -0.44), (6, -1.94), (8.1, -2.0)))
    assert section.foreslope()[0] == pytest.approx(-0.5, abs=0.01)
    assert section.foreslope(up_to_m=2.5)[0] == pytest.approx(-0.2, abs=0.01)
    assert section.width_m("foreslope") == pytest.approx(5, abs=0.05)


def test_steepest_window_is_that_of_every_window():
    heights = bent((0, 0), (2, -0.1), (3, -0.6), (4, -0.5), (8.1, 0))
    pieces = fit_pieces(binned_profile(RUN, heights))
    starts = np.arange(0, 6.5, 0.01)
    slow = ((pieces.height_m(starts + 1.5) - pieces.height_m(starts)) / 1.5).min()
    assert steepest(pieces)[0] == pytest.approx(slow, abs=2e-3)
    assert steepest(pieces, 1)[0] == pytest.approx(0.5 / 4.1, abs=0.01)
    assert steepest(fit_pieces(binned_profile(RUN, -0.1 * RUN)), 1)[0] == 0


@given(st.integers(1, 4), st.integers(0, 10**6))
def test_made_sections_are_found_whatever_their_slopes(count, seed):
    rng = np.random.default_rng(seed)
    widths = rng.uniform(1.2, 2.2, count)
    slopes = np.cumsum(rng.choice([-1, 1], count) * rng.uniform(0.2, 0.5, count))
    corners = np.r_[0, np.cumsum(widths)]
    run = np.arange(0, corners[-1], 0.1)
    heights = np.interp(run, corners, np.r_[0, np.cumsum(widths * slopes)])
    pieces = fit_pieces(binned_profile(run, heights))
    assert len(pieces) == count
    assert pieces.slope == pytest.approx(slopes, abs=0.02)
    assert pieces.ends_m[1:-1] == pytest.approx(corners[1:-1], abs=0.05)


def test_noise_is_measured_beside_hinges_and_steps(rng):
    heights = bent((0, 0), (2, -0.5), (3, -0.5), (8.1, 1)) + rng.normal(0, 0.02, len(RUN))
    assert noise_of(RUN, heights) == pytest.approx(0.02, rel=0.35)
    assert noise_of(RUN[:4], heights[:4]) == 0


def test_few_heights_and_text():
    assert cross_section(Profile(RUN[:5], RUN[:5], RUN[:5] + 1)) is None
    with pytest.raises(InputError, match="too few heights"):
        fit_pieces(Profile(RUN[:2], RUN[:2], RUN[:2] + 1))
    assert [slope_text(s) for s in (-1 / 2.3, 0.001, np.nan)] == ["1V:2.3H", "level", "unknown"]
    nothing = profile_from_points(np.zeros(2), np.array([1.0, 0]), np.zeros((1, 3)), 8.0)
    assert cross_section(nothing) is None
