import cv2
import numpy as np
import pytest

from roadsight.geometry.cameras import Intrinsics, project
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.stages.poles.measure_poles import FARTHEST_M, markings_on_ground

LENS = Intrinsics.from_field_of_view(640, 416, 50.0)
GRADE = 0.05
SMALLEST_PX = 60.0


def ground(x, y):
    """A plane that rises to the north."""
    return GRADE * np.asarray(y) + 0.0 * np.asarray(x)


def drawn(camera, offsets_m):
    """Mask of lines 0.12 m wide along the road to the north."""
    mask = np.full((416, 640), int(PixelClass.ROAD), np.uint8)
    along = np.arange(3.0, 60.0, 0.5)
    for offset in offsets_m:
        sides = [np.column_stack([np.full(len(along), offset + s), along]) for s in (-0.06, 0.06)]
        ring = np.concatenate([sides[0], sides[1][::-1]])
        points = np.column_stack([ring, ground(*ring.T)])
        uv, _ = project(camera.intrinsics, camera.rotation(), camera.position_m, points)
        # Sixteenths of a pixel.
        cv2.fillPoly(mask, [np.round(uv * 16).astype(np.int32)], int(PixelClass.MARKING), shift=4)
    return mask


@pytest.mark.parametrize("heading_deg", [-3.0, 0.0, 4.0])
def test_lines_lie_where_they_are_painted(heading_deg):
    camera = ViewCamera(LENS, (0.3, 0.0, 2.4), heading_deg, -2.0, 0.4)
    lines = (-3.1, 0.0, 3.1)
    found = markings_on_ground(camera, drawn(camera, lines), ground, SMALLEST_PX)
    assert len(found) > 100
    assert np.hypot(found[:, 0] - 0.3, found[:, 1]).max() <= FARTHEST_M
    away = np.abs(found[:, :1] - np.array(lines))
    assert np.quantile(away.min(axis=1), 0.95) < 0.06
    for n in range(3):
        own = found[away.argmin(axis=1) == n]
        assert np.median(own[:, 0]) == pytest.approx(lines[n], abs=0.02)
        assert np.ptp(own[:, 1]) > 15


def test_a_mask_without_markings_and_a_sky_give_none():
    camera = ViewCamera(LENS, (0.0, 0.0, 2.4), 0.0)
    none, above = np.zeros((2, 416, 640), np.uint8)
    above[20:30, 100:500] = int(PixelClass.MARKING)
    for mask in (none, above):
        assert markings_on_ground(camera, mask, ground, SMALLEST_PX).shape == (0, 2)


def test_markings_smaller_than_asked_are_none():
    camera = ViewCamera(LENS, (0.0, 0.0, 2.4), 0.0)
    mask = np.zeros((416, 640), np.uint8)
    mask[300:310, 318:322] = int(PixelClass.MARKING)
    # 40 px of an image 416 px high are 333 of one 1200 px high.
    assert len(markings_on_ground(camera, mask, ground, 300.0)) > 0
    assert markings_on_ground(camera, mask, ground, 350.0).shape == (0, 2)
