from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from roadsight.poles.triangulate.explain import explain_rays
from roadsight.poles.triangulate.rays import UNAIDED
from roadsight.poles.triangulate.site import (
    CALIBRATED,
    one_thing_probability,
    probability_source,
    real_probability,
)
from tests.helpers.drives import Drive, rays_and_poles, simulate

DRIVES = (
    Drive(strays=0.3, shown=0.6),
    Drive(strays=0.7, shown=0.5, bend_m=150.0),
    Drive(strays=0.5, shown=0.7, gap_m=30.0, step_m=10.0),
    Drive(strays=0.9, shown=0.6, place_m=0.8, turn_deg=1.8, depth=0.25),
)
"""Rates of strays and shares of images other than those of the fit; seeds are too."""
ROAD = (
    (6.2, 0.04, 1), (55.3, 0.01, 1), (45.6, 0.04, 1), (57.0, 0.02, 1), (31.2, 0.23, 1),
    (19.5, 0.11, 1), (30.6, 0.03, 1), (4.5, 1.49, 0), (41.7, 0.01, 1), (17.2, 0.39, 1),
    (8.3, 0.43, 0), (59.7, 0.03, 1), (4.2, 0.11, 0), (46.2, 0.04, 1), (41.5, 0.04, 1),
    (3.1, 1.45, 0), (36.4, 0.05, 1), (57.7, 0.01, 1), (28.3, 0.01, 1), (29.6, 0.34, 1),
    (40.2, 0.01, 1), (12.3, 0.08, 1), (22.5, 0.57, 1), (50.8, 0.07, 1), (44.2, 0.67, 1),
    (46.3, 0.86, 1), (25.7, 0.85, 1), (75.0, 0.08, 1), (47.7, 0.48, 1), (10.6, 0.80, 1),
    (11.9, 0.49, 1), (4.2, 0.62, 0), (4.2, 2.81, 0), (4.5, 0.62, 0), (25.5, 0.44, 1),
    (7.0, 8.08, 0), (6.2, 0.52, 0), (24.4, 0.66, 1), (79.5, 0.07, 1), (88.5, 0.05, 1),
    (87.9, 0.09, 1), (40.0, 0.63, 1), (7.0, 1.27, 0), (49.4, 0.58, 1), (54.3, 0.11, 1),
    (17.9, 1.90, 1),
)  # fmt: skip
"""Evidence, error (m), and whether it is a pole, of groups on a generated road of another seed than
the one of the fit, in two clouds, by the shipped network's masks."""


PANELS = (
    *((42.2, True, 1), (22.3, False, 0), (17.1, False, 0), (7.5, False, 0), (34.7, True, 1)),
    *((17.2, False, 0), (42.5, True, 1), (13.6, False, 0), (8.5, False, 0), (33.2, True, 1)),
    *((46.7, True, 1), (14.6, False, 0), (38.1, True, 1), (8.1, False, 0), (49.1, True, 1)),
    *((50.0, True, 1), (13.6, True, 1), (10.1, True, 0), (49.7, True, 1), (13.6, False, 0)),
    *((20.3, True, 1), (35.4, True, 1), (22.0, False, 0), (40.5, True, 1), (30.9, True, 1)),
)
"""Evidence, whether it is kept, and whether it is a sign, of panels on two generated roads of other
seeds than those of the fit, by the shipped network's masks."""


def table(evidence, sigma_m, kind, decided=""):
    columns = {"kind": kind, "evidence": evidence, "sigma_major_m": sigma_m, "decided": decided}
    columns |= {"score": 3, "kept": True, "cloud_shows": ""}
    return pd.DataFrame(columns)


@pytest.fixture(scope="module")
def groups():
    """Probability and truth of groups of simulated drives."""
    said, real = [], []
    for drive in DRIVES:
        for seed in range(3000, 3006):
            _, rows = simulate(replace(drive, poles=25), seed)
            rays, own = rays_and_poles(rows)
            found = explain_rays(rays, UNAIDED)
            evidence = found.gain + UNAIDED.pole_evidence
            said += one_thing_probability(evidence).tolist()
            real += [_shows_one(own[members]) for members in found.groups]
    return np.array(said), np.array(real)


def _shows_one(own):
    views = np.bincount(own[own >= 0], minlength=1)
    return bool(views.max() >= 2)


def test_of_what_is_said_to_be_likely_as_many_are_real(groups):
    said, real = groups
    assert len(said) > 500 and 0.03 < 1.0 - real.mean() < 0.4
    assert said.mean() == pytest.approx(real.mean(), abs=0.04)
    for low, high in ((0.0, 0.6), (0.6, 0.85), (0.85, 0.97), (0.97, 1.0)):
        own = (said > low) & (said <= high)
        assert own.sum() > 30
        spread = np.sqrt(said[own].mean() * (1 - said[own].mean()) / own.sum())
        assert real[own].mean() == pytest.approx(said[own].mean(), abs=0.05 + 2.5 * spread)


def test_poles_of_another_road_are_as_often_real_as_is_said():
    evidence, sigma_m, real = np.array(ROAD).T
    said = real_probability(table(evidence, sigma_m, "pole"))
    assert said.sum() == pytest.approx(real.sum(), abs=2.0)
    assert ((said - real) ** 2).mean() < 0.6 * real.mean() * (1 - real.mean())
    sure = said > 0.9
    assert sure.sum() > 0.75 * real.sum() and real[sure].mean() > 0.95
    assert real[said < 0.5].mean() < 0.5


def test_more_evidence_is_more_likely_and_a_wider_error_less():
    more = real_probability(table(np.array([0.0, 5.0, 20.0]), np.full(3, 0.3), "pole"))
    assert (np.diff(more) > 0).all() and more[0] > 0.0 and more[-1] < 1.0
    wider = real_probability(table(np.full(3, 10.0), np.array([0.1, 1.0, 4.0]), "pole"))
    assert (np.diff(wider) < 0).all()


def test_what_a_person_decided_is_certain_and_what_nothing_tells_unknown():
    rows = table(np.array([2.0, 2.0, 40.0, np.nan]), np.full(4, 0.5), "pole")
    rows["decided"] = ["accepted", "moved", "rejected", ""]
    found = real_probability(rows)
    assert found[:3].tolist() == [1.0, 1.0, 0.0] and np.isnan(found[3])
    assert len(real_probability(rows[:0])) == 0


def test_panels_of_other_roads_are_as_often_signs_as_is_said():
    evidence, kept, real = np.array(PANELS).T
    kept = kept.astype(bool)
    rows = table(evidence, np.full(len(kept), 0.4), "sign").assign(kept=kept)
    said = real_probability(rows)
    # Two standard deviations of so few.
    spread = 2 * np.sqrt((said * (1 - said))[kept].sum())
    assert said[kept].sum() == pytest.approx(real[kept].sum(), abs=spread)
    assert np.isnan(said[~kept]).all()


def test_each_probability_says_what_tells_it_and_each_gap_why():
    kinds = ["pole", "pole", "sign", "sign", "tree", "tree", "building", "headwall"]
    rows = table([20.0, np.nan, 20.0, 20.0, *[np.nan] * 4], np.full(8, 0.3), kinds)
    rows = rows.assign(kept=[True] * 3 + [False] + [True] * 4, score=[3] * 5 + [0, 3, 3])
    found = real_probability(rows)
    told = probability_source(rows, found)
    assert (np.isnan(found) == [False, True, False, True, False, True, True, True]).all()
    assert [text == CALIBRATED for text in told] == (~np.isnan(found)).tolist()
    assert all(text.startswith("none: ") for text in told[np.isnan(found)])
    decided = rows.assign(decided=["accepted", *[""] * 6, "rejected"])
    told = probability_source(decided, real_probability(decided))
    assert told[0] == told[-1] == "a person's decision"
    assert len(probability_source(rows[:0], found[:0])) == 0


def test_trees_have_one_where_an_image_shows_them_and_buildings_none():
    rows = table(np.full(4, np.nan), np.full(4, 0.8), ["tree", "tree", "tree", "building"])
    found = real_probability(rows.assign(score=[2, 0, 2, 4], kept=[True, True, False, True]))
    assert found[0] == pytest.approx(0.98) and np.isnan(found[1:]).all()


def test_what_the_cloud_shows_of_a_tree_changes_its_probability():
    shows = ["trunk", "trunk", "crown", "no trunk"]
    dense = real_probability(table(np.full(4, np.nan), 0.8, "tree").assign(cloud_shows=shows))
    assert dense[0] > 0.99 and 0.4 < dense[3] < 0.8 < dense[2] < 0.98
    # Where no trunk is seen at all, as from the air, a crown alone says nothing.
    rows = table(np.full(4, np.nan), 0.8, "tree").assign(cloud_shows="crown")
    assert real_probability(rows) == pytest.approx(0.98)
    # What is withheld has none, and does not count.
    rows = rows.assign(cloud_shows=shows, kept=[False, False, True, True])
    assert real_probability(rows)[2] == pytest.approx(0.98)
