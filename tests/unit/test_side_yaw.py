from __future__ import annotations

import cv2
import numpy as np
import pytest

from roadsight.geometry.cameras import Intrinsics
from roadsight.poles.side_yaw import estimate_yaw_deg

CAMERA = Intrinsics.from_field_of_view(320, 160, 60.0)


def view(yaw_deg: float, gain: float = 1.0, seed: int = 0) -> np.ndarray:
    """A textured far cylinder seen by a level camera that looks towards a yaw."""
    texture = np.random.default_rng(seed).integers(0, 255, (90, 720)).astype(np.float32)
    texture = cv2.GaussianBlur(texture, (0, 0), 1.5)
    texture = (texture - texture.min()) / np.ptp(texture) * 255
    v, u = np.mgrid[:160, :320].astype(np.float32)
    x, y = (u - CAMERA.cx_px) / CAMERA.focal_px, (v - CAMERA.cy_px) / CAMERA.focal_px
    azimuth = np.degrees(np.arctan(x)) + yaw_deg + 180
    rise = y / np.hypot(1.0, x)
    drawn = cv2.remap(
        texture, (azimuth * 2).astype(np.float32), (45 + 90 * rise).astype(np.float32),
        cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT,
    )  # fmt: skip
    return np.clip(gain * drawn, 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2)


@pytest.mark.parametrize(("yaw", "guess"), [(47.3, 45.0), (-42.0, -45.0)])
def test_yaw_is_found_in_the_overlap_whatever_the_exposure(yaw, guess):
    found, score = estimate_yaw_deg([(view(0.0), view(yaw, gain=0.6))], CAMERA, guess, 4.0)
    assert found == pytest.approx(yaw, abs=0.15)
    assert score > 0.8


def test_views_that_share_nothing_give_no_yaw():
    assert np.isnan(estimate_yaw_deg([(view(0.0), view(90.0))], CAMERA, 90.0, 2.0)[0])
    assert np.isnan(estimate_yaw_deg([(view(0.0), view(45.0, seed=3))], CAMERA, 45.0, 2.0)[0])
    assert np.isnan(estimate_yaw_deg([], CAMERA, 45.0, 2.0)[0])
