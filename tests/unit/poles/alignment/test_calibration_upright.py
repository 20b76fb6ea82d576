import numpy as np
import pandas as pd
import pytest

from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.poles.alignment.drive import image_edges_of, loader, places_of, sight_of
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.pose import FOCAL, LATERAL, ROLL, YAW, Spread
from roadsight.poles.alignment.roadside import NearEdges, RoadEdges
from roadsight.poles.alignment.solve import Noise
from roadsight.poles.calibration.calibration import weak_mount, with_centre_held
from roadsight.poles.calibration.calibration_upright import aimed
from roadsight.poles.sightings.lidar_poles import PoleColumns
from tests.helpers.road_bed import Mount as BedMount
from tests.helpers.road_bed import RoadBed, frames_of

HFOV_DEG = 70.0
HEIGHT_M = 8.0
NOISE = LandmarkNoise()


@pytest.fixture(scope="module")
def bed():
    mount = BedMount(hfov_deg=HFOV_DEG, yaw_deg=2.5, roll_deg=-3.0)
    return RoadBed(seed=4, images=30, spacing_m=4.0, gps_m=0.3, mount=mount)


def columns_beside(bed, rng):
    """Posts every 6 m or so on both sides, at various distances."""
    heading = np.radians([pose.heading_deg for pose in bed.truth])
    right = np.column_stack([np.cos(heading), -np.sin(heading)])
    ahead = np.column_stack([np.sin(heading), np.cos(heading)])
    picked = [(k, side) for k in range(0, bed.images, 2) for side in (-1.0, 1.0)]
    xy = np.array(
        [
            bed.track[k] + side * rng.uniform(5, 12) * right[k] + rng.uniform(-2, 12) * ahead[k]
            for k, side in picked
        ]
    )
    ground = np.array([bed.z_road[k] for k, _ in picked])
    parts = np.full(len(xy), HEIGHT_M), np.full(len(xy), 0.05), ground
    return PoleColumns(xy, *parts, np.full(len(xy), 20.0), np.zeros(len(xy)))


def axes_of(bed, number, columns, rng):
    """Rows of the axes of one image: most of the columns, and as many again that are none."""
    pose = bed.truth[number]
    camera = Intrinsics.centred(bed.width_px, bed.height_px, bed.intrinsics.focal_px)
    rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
    rows = []
    for foot, ground in zip(columns.xy_m, columns.z_ground_m, strict=True):
        if rng.random() < 0.2 or np.hypot(*(foot - pose.position_m[:2])) > 45.0:
            continue
        line = np.column_stack([np.tile(foot, (2, 1)), ground + np.array([0.0, HEIGHT_M])])
        uv, depth = project(camera, rotation, pose.position_m, line)
        if depth.min() > 4.0 and camera.contains(uv[:1]).all():
            rows.append((*uv[0], *uv[1]))
    for _ in range(len(rows)):
        u, v = rng.uniform(0, bed.width_px), rng.uniform(0.5, 0.9) * bed.height_px
        lean = rng.normal(np.tan(np.radians(-pose.roll_deg)), 0.02)
        rows.append((u, v, u - lean * 300, v - 300))
    table = np.array(rows).reshape(-1, 4) + rng.normal(0, 0.5, (len(rows), 4))
    slope = (table[:, 0] - table[:, 2]) / (table[:, 1] - table[:, 3])
    half = 0.5 * (table[:, :2] + table[:, 2:])
    return pd.DataFrame(
        {
            "view": "front", "u": half[:, 0], "v": half[:, 1], "slope": slope,
            "v_foot": table[:, 1], "v_top": table[:, 3], "width_px": 4.0,
            "width_view_px": float(bed.width_px), "height_view_px": float(bed.height_px),
            "foot_visible": True, "top_cut": False,
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def loaders(bed):
    rng = np.random.default_rng(8)
    columns = columns_beside(bed, rng)
    edges, reach = RoadEdges.from_points(bed.road_edges), Reach()
    nothing = pd.DataFrame({name: [] for name in ("u", "v", "side", "kind")})
    seen = image_edges_of(nothing, reach)
    empty = NearEdges(*(np.empty((0, 3)) for _ in range(3)), np.empty(0), 0)
    made = []
    for number, place in enumerate(places_of(frames_of(bed), edges, reach)):
        sight = sight_of(place, axes_of(bed, number, columns, rng), columns, NOISE)
        made.append(loader(place, seen, empty, Noise(), sight))
    return made


def test_lens_and_direction_are_found_without_any_road_edge(bed, loaders):
    prior = with_centre_held(weak_mount(HFOV_DEG * 1.05, bed.width_px))
    found = aimed(prior, loaders, NOISE, Spread())
    focal = np.exp(found.mean[FOCAL])
    assert focal == pytest.approx(bed.intrinsics.focal_px, rel=0.03)
    assert abs(focal / bed.intrinsics.focal_px - 1) < abs(
        np.exp(prior.mean[FOCAL]) / bed.intrinsics.focal_px - 1
    )
    assert found.mean[YAW] == pytest.approx(bed.mount.yaw_deg, abs=0.5)
    sigma = np.sqrt(np.diag(found.covariance))
    assert sigma[YAW] < 0.5 and sigma[LATERAL] < 0.5


def test_roll_is_that_at_which_poles_stand_upright(bed, loaders):
    found = aimed(weak_mount(HFOV_DEG, bed.width_px), loaders, NOISE, Spread())
    roll_deg = np.median([pose.roll_deg for pose in bed.truth])
    assert found.mean[ROLL] == pytest.approx(roll_deg, abs=0.6)


def test_too_few_poles_change_nothing(bed, loaders):
    prior = weak_mount(HFOV_DEG, bed.width_px)
    assert aimed(prior, loaders[:1], NOISE, Spread()) is prior
