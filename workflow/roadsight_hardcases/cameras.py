"""Camera poses: projection, calibration, alignment, registration."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.base.arrays import Numbers
from roadsight.evidence.scores import camera_errors
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.poles.alignment.drift import Drift, DriftModel
from roadsight.poles.alignment.pose import SIZE, Spread
from roadsight.poles.alignment.solve import Fit
from roadsight.poles.calibration.calibration import Mount, shared_mean
from roadsight.poles.calibration.registration import register_camera
from roadsight.poles.sightings.lidar_poles import stem_axis
from roadsight.poles.sightings.rails import find_rail_returns, join_rails
from roadsight_hardcases.case import Errors, hard_case

# An ordinary camera of videologs: width and height px, focal length px.
_LENS = Intrinsics.centred(1920, 1200, 1600.0)


@hard_case("measure_poles", bound=0.5, unit="points in the image that are behind the camera")
def points_behind_the_camera(rng: np.random.Generator) -> Errors:
    """Divided by a negative depth, what lies behind the camera appears upside down in the image."""
    points = rng.uniform(-30, 30, (4000, 3)) * [1, 1, 0.1]
    rotation, at = cam_from_world(0.0, 0.0, 0.0), np.array([0.0, 0.0, 2.0])
    x, y, z = rotation @ (points - at).T
    uv = np.column_stack([_LENS.cx_px + 1600 * x / z, _LENS.cy_px + 1600 * y / z])
    ours, _ = project(_LENS, rotation, at, points)
    behind = points[:, 1] <= 0
    return (_LENS.contains(uv) & behind).sum(), (_LENS.contains(ours) & behind).sum()


@hard_case("calibrate_drive", bound=0.2, unit="m")
def images_that_know_one_direction(rng: np.random.Generator) -> Errors:
    """Images on a straight road say nothing about the place along it, yet a mean counts them."""
    count, true = 40, np.array([0.6, -0.3])
    station = np.arange(0.0, 10.0 * count, 10.0)
    along = np.array([0.0, 1.0])
    covariance = (
        0.03**2 * np.eye(2)
        + 400.0 * np.outer(along, along) * (np.arange(count) % 4 > 0)[:, None, None]
    )
    offset = np.array([rng.multivariate_normal(true, one) for one in covariance])
    drift = Drift(station, offset, covariance, DriftModel(own_m=0.02, length_m=1000.0))
    ours = np.array([drift.at(place)[0] for place in station])
    window = np.array([offset[max(k - 5, 0) : k + 6].mean(axis=0) for k in range(count)])
    naive, found = (np.median(np.hypot(*(part - true).T)) for part in (window, ours))
    return naive, found


@hard_case("calibrate_drive", bound=0.15, unit="deg")
def images_that_each_know_a_part(rng: np.random.Generator) -> Errors:
    """No image determines all numbers of the mount: a mean of their own answers is void."""
    # So many that the bound is over four times the spread of an image over their number's root.
    spread, true = Spread(), np.zeros(SIZE)
    true[3:6] = 1.2, -2.0, 0.4
    prior = Mount(np.zeros(SIZE), np.diag(np.full(SIZE, 9.0)))
    fits, alone = [], []
    for _ in range(240):
        own = true + rng.normal(0, 1, SIZE) * spread.vector()
        view = rng.normal(0, 1, (SIZE - 3, SIZE)) / spread.vector() / 0.05
        normal = view.T @ view
        zero = np.zeros(SIZE)
        fits.append(Fit(own, np.eye(SIZE), 0.0, np.zeros((1, 2)), normal, zero))
        alone.append(np.linalg.lstsq(view, view @ own, rcond=None)[0])
    ours = shared_mean(fits, prior, spread).mean
    return np.abs(np.mean(alone, axis=0) - true)[3:6].max(), np.abs(ours - true)[3:6].max()


@hard_case("find_pole_columns", bound=0.09, unit="m")
def stem_seen_from_one_side(rng: np.random.Generator) -> Errors:
    """Returns lie on the side that faces the scanner: their mean is not the axis of the pole."""
    naive = ours = 0.0
    for _ in range(20):
        axis = rng.uniform(-50, 50, 2)
        turn = rng.uniform(0, 2 * np.pi) + rng.uniform(-0.6, 0.6, 30)
        xy = axis + 0.13 * np.column_stack([np.cos(turn), np.sin(turn)])
        xy = xy + rng.normal(0, 0.005, xy.shape)
        naive = max(naive, np.hypot(*(xy.mean(axis=0) - axis)))
        ours = max(ours, np.hypot(*(stem_axis(xy)[0] - axis)))
    return naive, ours


@hard_case("find_roadside_objects", bound=0.2, unit="share")
def rail_on_a_bridge(rng: np.random.Generator) -> Errors:
    """Above the terrain below a bridge its rails stand as high as a house. Share of one missed."""
    length_m, deck_m = 60.0, 6.0
    rail = np.column_stack([rng.uniform(0, length_m, 150), np.zeros(150), np.full(150, 0.65)])
    deck = np.column_stack([rng.uniform([0, -8], [length_m, 0], (4800, 2)), np.zeros(4800)])
    xyz = np.vstack([rail, deck]) + rng.normal(0, 0.02, (4950, 3))
    xyz[:, 2] += deck_m
    bridge = np.repeat([1, 17], [150, 4800])
    missed = []
    for cls in (np.ones_like(bridge), bridge):
        found = join_rails(find_rail_returns(xyz, xyz[:, 2], cls))
        steps_m = sum(np.hypot(*np.diff(line[:, :2], axis=0).T).sum() for line in found)
        missed.append(abs(1.0 - steps_m / length_m))
    return missed[0], missed[1]


@hard_case("calibrate_drive", bound=1.0, unit="m")
def clicks_on_the_road_alone(rng: np.random.Generator) -> Errors:
    """Clicked places that all lie on the road leave the linear camera matrix undetermined."""
    far = np.array([632_000.0, 4_123_000.0, 100.0])
    places = rng.uniform([-12, 8, 0], [12, 60, 0], (14, 3))
    at, rotation = np.array([0.4, -0.6, 2.3]), cam_from_world(3.0, -2.0, 0.5)
    uv, _ = project(_LENS, rotation, at, places)
    clicked = uv + rng.normal(0, 0.3, uv.shape)
    found = register_camera(clicked, places + far, 1920, 1200)
    centre = _direct_linear_centre(clicked, places + rng.normal(0, 1e-3, places.shape))
    return min(float(np.linalg.norm(centre - at)), 1e9), np.linalg.norm(found.position_m - at - far)


def _direct_linear_centre(uv: Numbers, xyz: Numbers) -> Numbers:
    """Camera centre by the direct linear transform, as textbooks write it."""
    rows, ones = [], np.column_stack([xyz, np.ones(len(xyz))])
    for (u, v), place in zip(uv, ones, strict=True):
        rows += [np.concatenate([place, np.zeros(4), -u * place])]
        rows += [np.concatenate([np.zeros(4), place, -v * place])]
    matrix = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 4)
    return -np.linalg.solve(matrix[:, :3], matrix[:, 3])


@hard_case("score_cameras", bound=0.5, unit="deg")
def headings_on_either_side_of_north(rng: np.random.Generator) -> Errors:
    """A camera at 359.95 degrees that truly looks at 0.05 is scored as 359.9 degrees off."""
    pose = {"x": 0.0, "y": 0.0, "z": 2.0, "pitch_deg": 0.0, "roll_deg": 0.0, "focal_px": 1600.0}
    lens = {"cx_px": 959.5, "cy_px": 599.5, "width_px": 1920, "height_px": 1200}
    found = pd.DataFrame([{"image": "a", "heading_deg": 359.95, "accepted": True} | pose | lens])
    truth = pd.DataFrame([{"image": "a", "heading_deg": 0.05} | pose | lens])
    edges = np.column_stack([np.full(80, 3.5), np.arange(0, 80.0), np.zeros(80)])
    errors = camera_errors(found, truth, edges, np.tile([0.0, 1.0], (80, 1)))
    return abs(359.95 - 0.05), abs(errors["yaw_deg"][0])
