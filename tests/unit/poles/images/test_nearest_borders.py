import numpy as np

from roadsight.base.sections.poles import EdgeTracing
from roadsight.poles.images.image_edges import trace_edges
from roadsight.poles.images.kinds import PixelClass

ROWS = 375
COLUMNS = 1242


def street():
    """Road with a kerb on the right, paved forecourt beyond it, a car on the left."""
    mask = np.full((ROWS, COLUMNS), PixelClass.VEGETATION, np.uint8)
    for row in range(200, ROWS):
        half = (row - 180) * 2.2
        middle = COLUMNS // 2
        left, right = max(int(middle - half), 0), min(int(middle + half), COLUMNS - 1)
        mask[row, left:right] = PixelClass.ROAD
        mask[row, right : right + 8] = PixelClass.KERB
        mask[row, right + 8 : right + 8 + int(half * 0.5)] = PixelClass.ROAD
    mask[250:330, 250:420] = PixelClass.VEHICLE
    return mask


def test_the_far_side_of_a_forecourt_is_left_out():
    every = trace_edges(street(), EdgeTracing())
    near = trace_edges(street(), EdgeTracing(borders="nearest"))
    u, v = near.uv_px.T
    half = (v - 180) * 2.2
    right = near.side > 0
    expected = COLUMNS // 2 + half[right]
    inside = v[right] > 210
    assert np.abs(u[right] - expected)[inside].max() < 14
    far = every.uv_px[every.side > 0]
    beyond = far[:, 0] > COLUMNS // 2 + (far[:, 1] - 180) * 2.2 + 30
    assert beyond.sum() > 20
    assert 40 < right.sum() < (every.side > 0).sum()


def test_nothing_is_traced_behind_a_car():
    near = trace_edges(street(), EdgeTracing(borders="nearest"))
    u, v = near.uv_px.T
    behind = (near.side < 0) & (v > 255) & (v < 325)
    half = (v - 180) * 2.2
    covered = COLUMNS // 2 - half > 250
    assert not (behind & covered & (u < 420)).any()
    assert (near.side < 0).sum() > 40


def test_a_mask_without_road_has_no_border():
    empty = np.full((ROWS, COLUMNS), PixelClass.SKY, np.uint8)
    assert len(trace_edges(empty, EdgeTracing(borders="nearest")).uv_px) == 0
