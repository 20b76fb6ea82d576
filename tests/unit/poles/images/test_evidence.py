import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.poles.images.evidence import (
    FIELDS,
    GROUND,
    LEVEL,
    MARKED,
    RAISED,
    UPRIGHT,
    ImageEvidence,
    edge_field,
    edge_maps,
    surface_field,
)
from roadsight.poles.images.kinds import PixelClass

SHAPE = (90, 160)


def halves(axis: int) -> np.ndarray:
    image = np.full(SHAPE, 60, np.uint8)
    image[(slice(45, None), slice(None)) if axis == 0 else (slice(None), slice(80, None))] = 180
    return image


def test_edges_are_split_by_their_direction():
    upright, level = edge_maps(halves(1))
    assert upright[:, 79:81].max() > 1 and not level[20:-20, 20:-20].any()
    upright, level = edge_maps(halves(0))
    assert level[44:46].max() > 1 and not upright[20:-20, 20:-20].any()


def test_contrast_does_not_matter_much():
    faint, strong = (np.full(SHAPE, 100, np.uint8) for _ in range(2))
    faint[:, 80:], strong[:, 80:] = 110, 220
    ends = edge_maps(faint)[0][:, 79:81].max(), edge_maps(strong)[0][:, 79:81].max()
    assert ends[0] == pytest.approx(ends[1], rel=0.2)


def test_a_field_is_highest_on_its_edge():
    field = edge_field(edge_maps(halves(1))[0], 4.0)
    assert abs(int(field[45].argmax()) - 79.5) < 2
    assert field[45, 80] > 0 > field[45, 60]


def test_classes_raise_their_own_fields():
    classes = np.full(SHAPE, PixelClass.BUILDING, np.uint8)
    classes[45:] = PixelClass.ROAD
    classes[60:62, 30:120] = PixelClass.MARKING
    fields = ImageEvidence(halves(0), classes).at(2.0)
    assert fields.shape == (FIELDS, *SHAPE)
    assert fields[GROUND, 80, 80] > 0 > fields[GROUND, 10, 80]
    assert fields[RAISED, 10, 80] > 0 > fields[RAISED, 80, 80]
    assert fields[MARKED, 61, 80] > 0 > fields[MARKED, 75, 80]


def test_unknown_classes_and_blank_images_tell_nothing():
    blank = np.zeros(SHAPE, np.uint8)
    fields = ImageEvidence(blank, blank + int(PixelClass.OTHER)).at(3.0)
    assert np.isfinite(fields).all()
    for field in (UPRIGHT, LEVEL, MARKED, GROUND, RAISED):
        assert np.ptp(fields[field]) < 1e-5
    np.testing.assert_allclose(fields[[GROUND, RAISED]], 0.0, atol=1e-5)


def test_fields_are_kept():
    evidence = ImageEvidence(halves(0), halves(0) * 0)
    assert evidence.at(4.0) is evidence.at(4.0)


@given(st.integers(0, 2**31), st.sampled_from([2.0, 4.0, 8.0, 16.0]))
@settings(max_examples=20, deadline=None)
def test_fields_are_finite_and_bounded(seed, blur):
    random = np.random.default_rng(seed)
    grey = random.integers(0, 256, SHAPE).astype(np.uint8)
    classes = random.integers(0, len(PixelClass), SHAPE).astype(np.uint8)
    fields = ImageEvidence(grey, classes).at(blur)
    assert np.isfinite(fields).all()
    # No sample may count for or against a pose without bound.
    assert fields.min() >= np.log(0.1) - 1e-4 and fields.max() < 4.0
    mask = random.random(SHAPE) < 0.3
    own = surface_field(mask, np.ones(SHAPE, bool), blur)
    assert np.isfinite(own).all()
