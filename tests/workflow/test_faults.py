"""Each kind of fault strikes once, in one of the jobs; tests/faults has the long run."""

import numpy as np

from tests.faults.disturb import FAULTS, Disturbed, check_same, digests


def test_faults_in_the_placement_job(copy_of_finished):
    expected = digests(copy_of_finished.folder)
    struck = Disturbed(copy_of_finished, np.random.default_rng(6))
    struck.forget("tiny/placement/round-0/coverage.json")
    for fault in FAULTS[::2]:
        if not struck.strike(fault):
            struck.forget("tiny/placement/os-64/solution.json")
    struck.finish()
    check_same(struck.checkout.folder, expected)


def test_faults_in_the_pole_job(copy_of_road):
    expected = digests(copy_of_road.folder)
    struck = Disturbed(copy_of_road, np.random.default_rng(7))
    struck.forget("tiny_road/poles/sightings/0.parquet")
    for fault in FAULTS[1::2]:
        if not struck.strike(fault):
            struck.forget("tiny_road/poles/poles.parquet")
    struck.finish()
    check_same(struck.checkout.folder, expected)
