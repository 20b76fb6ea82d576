import numpy as np
import pytest

from roadsight.scene.pavement.pavement_doubts import ScanHeights, epoch_doubts


@pytest.fixture
def scanned(rng):
    """A road of 30 m x 8 m, 200 points a square metre, in four scans with 1 cm of noise."""
    xy = rng.uniform(0, (30, 8), (48_000, 2))
    scan = rng.integers(3, 7, len(xy))
    z = 0.02 * xy[:, 0] + rng.normal(0, 0.01, len(xy)) + np.array([0.0, 0.01, -0.01, 0.0])[scan - 3]
    return np.column_stack([xy, z]), scan


def told(xyz_m, scan, parts=1):
    heights = ScanHeights()
    for part in range(parts):
        own = np.floor(xyz_m[:, 0] / (30 / parts)) == part
        heights.add(xyz_m[own], scan[own])
    return heights, {doubt.code: doubt for doubt in epoch_doubts(heights)}


def test_scans_that_agree_say_nothing(scanned):
    assert told(*scanned)[1] == {}


@pytest.mark.parametrize("off_m", [0.12, -0.4])
def test_a_scan_that_lies_off_as_a_whole_is_named(scanned, off_m):
    xyz_m, scan = scanned
    xyz_m[scan == 5, 2] += off_m
    doubts = told(xyz_m, scan)[1]
    assert set(doubts) == {"pavement_scans_apart"}
    assert doubts["pavement_scans_apart"].measured == pytest.approx(abs(off_m), abs=0.03)
    assert "scan 5 lies above" in doubts["pavement_scans_apart"].message or off_m < 0


def test_half_of_the_scans_of_another_epoch(scanned):
    xyz_m, scan = scanned
    xyz_m[scan < 5, 2] += 0.2
    doubts = told(xyz_m, scan)[1]
    assert doubts["pavement_scans_apart"].measured == pytest.approx(0.22, abs=0.03)


def test_a_lane_that_was_resurfaced(scanned):
    xyz_m, scan = scanned
    xyz_m[(scan == 4) & (xyz_m[:, 1] < 3.5), 2] += 0.15
    doubts = told(xyz_m, scan)[1]
    assert set(doubts) == {"pavement_epochs"}
    assert doubts["pavement_epochs"].measured == pytest.approx(3.5 / 8, abs=0.05)


def test_thick_layers_are_no_epochs(scanned, rng):
    xyz_m, scan = scanned
    xyz_m[:, 2] += rng.normal(0, 0.05, len(xyz_m))
    assert told(xyz_m, scan)[1] == {}


def test_one_scan_and_no_points_say_nothing(scanned):
    xyz_m, scan = scanned
    assert told(xyz_m, np.zeros_like(scan))[1] == {}
    assert told(xyz_m[:0], scan[:0])[1] == {} and epoch_doubts(ScanHeights()) == []


def test_heights_are_those_of_a_slow_reference_and_of_tiles(scanned):
    xyz_m, scan = scanned
    whole, tiles = told(xyz_m, scan)[0], told(xyz_m, scan, parts=3)[0]
    wanted = []
    place = np.floor(xyz_m[:, :2] / 0.5).astype(int)
    for cell in np.unique(place, axis=0):
        own = (place == cell).all(axis=1)
        means = [
            xyz_m[own & (scan == one), 2].mean()
            for one in range(3, 7)
            if (own & (scan == one)).sum() >= 3
        ]
        wanted += list(np.array(means) - np.median(means)) if len(means) > 1 else []
    for found in (whole, tiles):
        off_m = np.concatenate(found.off_m)
        np.testing.assert_allclose(np.sort(off_m), np.sort(wanted), atol=1e-9)
        assert len(off_m) == sum(map(len, found.spread_m)) == sum(map(len, found.scan))
