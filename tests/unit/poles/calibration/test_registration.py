import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg
from roadsight.poles.calibration.registration import is_flat, register_camera

SIZE = 2000, 1200
AT = np.array([620_000.0, 5_100_000.0, 120.0])


def clicked(rng, count=10, hfov_deg=45.0, noise_px=0.0, flat=False, at=AT):
    """Places ahead of a camera at ``at`` and their pixels."""
    camera = Intrinsics.from_field_of_view(*SIZE, hfov_deg)
    rotation = cam_from_world(212.0, -2.5, 1.2)
    depth = rng.uniform(12, 90, count)
    half = 0.8 * np.tan(np.radians(hfov_deg) / 2)
    x, y = rng.uniform(-half, half, count) * depth, rng.uniform(-0.25, 0.2, count) * depth
    if flat:
        y = np.full(count, 2.4)
    xyz = at + np.column_stack([x, y, depth]) @ rotation
    uv, _ = project(camera, rotation, at, xyz)
    return uv + rng.normal(0, noise_px, uv.shape), xyz, camera.focal_px


@pytest.mark.parametrize("hfov_deg", [20.0, 60.0, 95.0])
def test_exact_pairs_give_the_exact_camera(rng, hfov_deg):
    uv, xyz, focal_px = clicked(rng, hfov_deg=hfov_deg)
    found = register_camera(uv, xyz, *SIZE)
    np.testing.assert_allclose(found.position_m, AT, atol=0.02)
    assert abs(found.focal_px / focal_px - 1) < 1e-3
    assert abs(wrap_deg(found.heading_deg - 212.0)) < 0.02
    assert abs(found.pitch_deg + 2.5) < 0.02
    assert abs(found.roll_deg - 1.2) < 0.02
    assert found.residuals_px.max() < 0.1


def test_sigma_is_about_the_error(rng):
    errors = []
    for _ in range(12):
        uv, xyz, focal_px = clicked(rng, count=12, noise_px=2.0)
        found = register_camera(uv, xyz, *SIZE)
        gap = np.append(found.position_m - AT, np.log(found.focal_px / focal_px))
        errors.append(gap / found.sigma[[0, 1, 2, 6]])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms > 0.5).all() and (rms < 1.7).all()


def test_flat_places_are_told_and_solved(rng):
    uv, xyz, focal_px = clicked(rng, flat=True)
    assert is_flat(xyz) and not is_flat(clicked(rng)[1])
    assert abs(register_camera(uv, xyz, *SIZE).focal_px / focal_px - 1) < 0.02


def test_order_of_pairs_does_not_matter(rng):
    uv, xyz, _ = clicked(rng, noise_px=1.0)
    order = rng.permutation(len(uv))
    one, two = register_camera(uv, xyz, *SIZE), register_camera(uv[order], xyz[order], *SIZE)
    np.testing.assert_allclose(one.position_m, two.position_m, atol=1e-3)


def test_refuses_what_cannot_be_solved(rng):
    uv, xyz, _ = clicked(rng)
    with pytest.raises(InputError, match="too few"):
        register_camera(uv[:3], xyz[:3], *SIZE)
    with pytest.raises(InputError, match="not finite"):
        register_camera(np.where(uv == uv[0, 0], np.nan, uv), xyz, *SIZE)
    line = AT + np.linspace(10, 60, 10)[:, None] * [0.3, 0.9, 0.0]
    with pytest.raises(InputError, match="one line"):
        register_camera(uv, line, *SIZE)
    with pytest.raises(InputError, match=r"different places|one line"):
        register_camera(uv[:4], xyz[[0, 1, 2, 2]], *SIZE)
