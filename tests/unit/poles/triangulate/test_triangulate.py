import itertools

import numpy as np
import pandas as pd
import pytest

from roadsight.poles.sightings.sighting_bearing import OWN_COLUMN
from roadsight.poles.triangulate.explain import error_ellipse, explain_rays, triangulate
from roadsight.poles.triangulate.noise import place_groups, stated_noise
from roadsight.poles.triangulate.pole_doubts import (
    FILLED,
    LOW,
    STANDING,
    UNEVEN,
    are_filled,
    drop_near_structures,
    panel_edges,
    shares_above,
    withhold_by_height,
    withhold_filled,
    withhold_thin,
    withhold_under_crowns,
)
from roadsight.poles.triangulate.published import follows_sequence
from roadsight.poles.triangulate.rays import (
    UNAIDED,
    TriangulationSettings,
    cross_rays,
    make_rays,
    pair_rays,
)
from roadsight.poles.triangulate.site import POLE_COLUMNS, SHARED_COLUMNS, site_poles
from tests.helpers.pole_street import FINE, found, nearest, rays_of, street


def test_finds_every_pole_of_a_street():
    truth, rows = street()
    poles = found(rows)
    assert len(poles) == len(truth)
    assert nearest(poles, truth).min(axis=0).max() < 0.8
    assert poles["kept"].all()
    assert (poles["score"] >= 2).all()


def test_bearings_on_either_side_of_north_are_near_each_other():
    rows = np.array([[-1.0, 0, 5.0, 12, 0], [1.0, 0, -5.0, 12, 1], [0.0, -4, 360, 16, 2]])
    poles = found(rows)
    assert len(poles) == 1
    assert poles[["x", "y"]].to_numpy()[0] == pytest.approx([0, 12], abs=0.3)


def test_error_ellipse_of_two_rays_at_a_right_angle():
    rows = np.array([[0.0, -10, 0, np.nan, 0], [-10.0, 0, 90, np.nan, 1]])
    poles = found(rows)
    assert poles[["x", "y"]].to_numpy()[0] == pytest.approx([0, 0], abs=0.4)
    across = np.hypot(0.3, 20 * np.radians(0.5))
    assert poles["sigma_major_m"].to_numpy() == pytest.approx([across], rel=0.01)


@pytest.mark.parametrize("apart_deg", [0.0, 0.2])
def test_almost_parallel_rays_place_the_pole_by_depth(apart_deg):
    rows = np.array([[0.0, 0, 10, 15, 0], [0.0, 1, 10 + apart_deg, 14, 1]])
    poles = found(rows)
    assert len(poles) == 1
    ahead = np.array([np.sin(np.radians(10)), np.cos(np.radians(10))])
    assert poles[["x", "y"]].to_numpy()[0] @ ahead == pytest.approx(15, abs=0.6)
    assert poles["sigma_major_m"].iloc[0] > 5 * poles["sigma_minor_m"].iloc[0]
    assert poles["sigma_azimuth_deg"].iloc[0] == pytest.approx(10, abs=0.5)


def test_a_long_ellipse_withholds_the_pole_with_a_reason():
    rows = np.array([[0.0, 0, 10, 20, 0], [0.0, 1, 10, 19, 1]])
    poles = found(rows, UNAIDED.model_copy(update={"max_sigma_m": 0.5, "calibrate_depth": False}))
    assert poles["kept"].tolist() == [False]
    assert poles["reason"].iloc[0] == "error ellipse longer than 0.5 m"


def test_rays_that_cross_behind_a_camera_or_too_far_make_no_pole():
    back = np.array([[0.0, 0, -30, 10, 0], [4.0, 0, 30, 10, 1]])
    far = np.array([[0.0, 0, 2, 60, 0], [4.0, 0, -2, 60, 1]])
    assert len(found(back)) == len(found(far)) == 0


def test_one_image_never_sees_a_pole_twice():
    rows = np.array([[0.0, 0, 10, 10, 7], [1.0, 0, 5, 10, 7]])
    assert len(found(rows)) == 0
    rows[1, 4] = 8
    assert len(found(rows)) == 1


def test_a_standing_camera_makes_no_pole_alone():
    rows = np.array([[0.01 * n, 0, 30 + 0.1 * n, 10, n] for n in range(6)])
    assert len(found(rows)) == 0


@pytest.mark.parametrize("depth", [0.0, -3.0, np.nan, np.inf])
def test_unknown_depths_are_no_depths(depth):
    truth, rows = street(poles=3)
    rows[:, 3] = depth
    poles = found(rows)
    assert nearest(poles, truth).min(axis=0).max() < 2.5


def test_empty_and_single_rows():
    assert len(found(np.empty((0, 5)))) == 0
    assert len(found(street()[1][:1])) == 0
    bad = np.array([[np.nan, 0, 10, 5, 0], [0, 0, np.nan, 5, 1]])
    assert len(rays_of(bad)) == 0


def test_depth_scale_is_found_from_the_crossings():
    _, rows = street(poles=30, noise_depth=0.15, gap_m=5.0)
    rows[:, 3] /= 1.4
    calibrating = FINE.model_copy(update={"calibrate_depth": True})
    assert explain_rays(rays_of(rows), calibrating).scale == pytest.approx(1.4, rel=0.1)
    assert explain_rays(rays_of(rows[:12]), calibrating).scale == 1.0


def test_pairs_agree_with_all_pairs():
    _, rows = street()
    rays = rays_of(rows)
    slow = [
        [i, j]
        for i, j in itertools.combinations(range(len(rays)), 2)
        if rays.image[i] != rays.image[j]
        and 0.5 <= np.hypot(*(rays.camera_m[i] - rays.camera_m[j])) <= 60
    ]
    assert pair_rays(rays, FINE).tolist() == slow


def test_crossings_and_parallel_rays():
    rays = make_rays([[0, 0], [10, 0], [20, 0]], [45, 315, 45], image=[0, 1, 2])
    along, place = cross_rays(rays, np.array([[0, 1], [0, 2]]))
    assert along[0] == pytest.approx([50**0.5] * 2)
    assert place[0] == pytest.approx([5, 5])
    assert np.isnan(along[1]).all()


def sequence_rays(depths, bearings):
    n = len(depths)
    return make_rays(
        np.column_stack([8.0 * np.arange(n), np.zeros(n)]), bearings, depths,
        image=np.arange(n), route=["r"] * n, sequence=np.arange(n),
    )  # fmt: skip


def test_sequence_rule():
    everyone = np.arange(3)
    assert follows_sequence(sequence_rays([30, 22, 14], [80, 75, 60]), everyone, FINE.sequence_m)
    assert follows_sequence(sequence_rays([30, 22, 14], [350, 355, 10]), everyone, FINE.sequence_m)
    assert not follows_sequence(
        sequence_rays([14, 22, 30], [80, 75, 60]), everyone, FINE.sequence_m
    )
    assert not follows_sequence(
        sequence_rays([30, 22, 14], [80, 60, 75]), everyone, FINE.sequence_m
    )
    far = sequence_rays([30, 22, 14], [80, 75, 60])
    assert not follows_sequence(far, everyone, 7.0)


def test_structures_withhold_poles():
    from scipy.spatial import cKDTree

    poles = pd.DataFrame({"x": [0.0, 9.0], "y": 0.0, "kept": True, "reason": ""})
    dropped = drop_near_structures(poles, cKDTree([[1.0, 0.0]]))
    assert dropped["kept"].tolist() == [False, True]
    assert "road, bridge or building" in dropped["reason"].iloc[0]
    assert drop_near_structures(poles, None)["kept"].all()


def test_ellipse_axes():
    major, minor, azimuth = error_ellipse(np.array([[[9.0, 0], [0, 1]], [[1.0, 0], [0, 4]]]))
    assert major.tolist() == [3, 2]
    assert minor.tolist() == [1, 1]
    assert azimuth.tolist() == [90, 0]


def site_table(rows, kind="pole"):
    n = len(rows)
    columns = {"image": [f"i{int(r[4]):03d}" for r in rows], "route": "r", "sequence": rows[:, 4]}
    columns |= {"kind": kind, "x": rows[:, 0], "y": rows[:, 1], "bearing_grid_deg": rows[:, 2]}
    columns |= {"depth_m": rows[:, 3], "sigma_bearing_deg": np.nan, "sigma_depth_m": np.nan}
    return pd.DataFrame(columns | {"kept": np.ones(n, bool)})


@pytest.mark.parametrize("method", ["packing", "sweep"])
def test_site_keeps_kinds_apart_and_names_images(method):
    _, rows = street(poles=3, noise_deg=0.05, noise_depth=0.02)
    both = pd.concat([site_table(rows), site_table(rows, "sign")], ignore_index=True)
    poles, pole_of, _ = site_poles(both, FINE.model_copy(update={"method": method}))
    assert set(POLE_COLUMNS) - {"z", "latitude", "longitude"} == set(poles.columns)
    assert poles.groupby("kind").size().to_dict() == {"pole": 3, "sign": 3}
    assert (poles["kind"].to_numpy()[pole_of[pole_of >= 0]] == both["kind"][pole_of >= 0]).all()
    first = both["image"][pole_of == 0]
    assert poles["images"].iloc[0] == ";".join(sorted(first))


def test_site_without_usable_sightings_is_an_empty_table():
    table = site_table(street()[1]).assign(kept=False)
    poles, pole_of, scales = site_poles(table, FINE)
    assert len(poles) == 0
    assert (pole_of == -1).all()
    assert scales == {}


def test_poles_of_few_views_need_the_cloud():
    poles = pd.DataFrame(
        {"score": [2, 2, 3, 2], "kept": [True, True, True, False], "reason": [""] * 3 + ["long"]}
    )
    pole_of = np.array([0, 0, 1, 1, 2, 2, 2, -1, 3, 3])
    in_cloud = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, 0], bool)
    found = withhold_thin(poles, pole_of, in_cloud, 3)
    assert found["kept"].tolist() == [False, True, True, False]
    assert "fewer than 3 images" in found["reason"][0]
    assert found["reason"][3] == "long"
    assert withhold_thin(poles, pole_of, in_cloud, 2)["kept"].tolist() == [True, True, True, False]


def test_what_stands_under_a_crown_is_a_trunk_unless_cloud_and_images_show_a_pole():
    poles = pd.DataFrame(
        {
            "kind": ["pole", "pole", "pole", "pole", "sign", "pole"],
            "score": [5, 5, 2, 5, 5, 5],
            "kept": [True, True, True, True, True, False],
            "reason": ["", "", "", "", "", "long"],
        }
    )
    pole_of = np.array([0, 0, 1, 2, 3, 4, 5, -1])
    in_cloud = np.array([False, False, True, True, False, False, False, True])
    above = np.array([0.9, 0.9, 0.9, 0.2, 0.9, 0.9])
    found = withhold_under_crowns(poles, pole_of, in_cloud, 3, above)
    assert found["kept"].tolist() == [False, True, False, True, True, False]
    assert found["reason"].tolist()[::5] == ["under a crown, and not clearly in the cloud", "long"]
    assert found["reason"][1] == ""


@pytest.mark.parametrize("base_m", [0.0, 2145.0])
def test_share_of_a_crown_counts_what_is_near_and_high_above_its_own_ground(base_m):
    ground = [[x, y, base_m] for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.5)]
    crown = [[10.0 + x, 0.0, base_m + z] for x in (-1.0, 0.0, 1.0) for z in (3.0, 6.0)]
    below = [[10.0, 0.0, base_m], [10.0, 0.5, base_m + 1.9]]
    far = [[10.0, 1.6, base_m + 9.0]]
    voxels = np.array(ground + crown + below + far)
    places = np.array([[0.0, 0.0], [10.0, 0.0], [50.0, 0.0], [10.0, 0.0]])
    heights = np.array([base_m, base_m, base_m, np.nan])
    assert shares_above(places, heights, voxels).tolist() == [0.0, 4 / 5, 0.0, 0.0]
    assert shares_above(places[:0], heights[:0], voxels).tolist() == []


def test_a_pole_s_own_returns_are_no_crown():
    ground = [[x, y, 0.0] for x in np.arange(-1.4, 1.5, 0.4) for y in np.arange(-1.4, 1.5, 0.4)]
    own = [[0.1, -0.1, z] for z in np.arange(0.2, 40.0, 0.2)]
    (share,) = shares_above(np.zeros((1, 2)), np.zeros(1), np.array(ground + own))
    assert share == 0.0


def _by_height(lower_m, upper_m, pole_of, poles, ground_m=100.0):
    """Panels 30 m ahead of a camera 2.2 m above the ground; three views must agree."""
    rises = (np.stack([lower_m, upper_m]) - 2.2) / 30.0
    sightings = pd.DataFrame({"x": 0.0, "y": 0.0, "z": 102.2, "lower_edge_rise": rises[0]})
    sightings["upper_edge_rise"] = rises[1]
    edges = panel_edges(poles, np.array(pole_of), sightings, np.full(len(poles), ground_m))
    return withhold_by_height(poles, edges, 3)


def test_panels_whose_lower_edges_are_on_the_ground_are_withheld():
    """A sign whose edge is at 1.5 m, a car, a pole alike, and what was withheld before.

    What lies behind the sign, a bank or the plain, does not count.
    """
    kinds = {"kind": ["sign", "sign", "pole", "sign"], "x": 0.0, "y": 30.0, "reason": ""}
    poles = pd.DataFrame(kinds).assign(kept=[True, True, True, False])
    lower_m = np.array([1.5, 1.4, 1.5, 0.2, 0.4, 1.9, 0.0, 0.0, 0.0])
    pole_of = [0, 0, 0, 1, 1, 1, 2, 3, -1]
    found = _by_height(lower_m, lower_m + 1.2, pole_of, poles)
    assert found["kept"].tolist() == [True, False, True, False]
    assert found["reason"].tolist() == ["", STANDING, "", ""]
    for of, ground_m in (([-1] * 9, 100.0), (pole_of, np.nan)):
        same = _by_height(lower_m, lower_m + 1.2, of, poles, ground_m)
        assert same["kept"].equals(poles["kept"])
    # where the ground is a metre higher, the sign stands on it too
    higher = _by_height(lower_m, lower_m + 1.2, pole_of, poles, 101.0)
    assert not higher["kept"].to_numpy()[:2].any()


def test_panels_without_one_height_and_letter_boxes_are_withheld():
    """A sign, one of which a view shows half, rays to branches that meet, and a letter box."""
    poles = pd.DataFrame({"kind": ["sign"] * 4, "x": 0.0, "y": 30.0, "reason": "", "kept": True})
    lower_m = np.array([1.9, 2.0, 1.9, 1.9, 1.9, 1.9, 0.4, 2.6, 2.9, 3.1, 3.6, 0.9, 0.9, 0.9])
    upper_m = np.array([2.7, 2.7, 2.6, 2.7, 2.7, 2.7, 0.9, 3.7, 3.4, 3.6, 4.4, 1.3, 1.3, 1.3])
    pole_of = [0] * 3 + [1] * 4 + [2] * 4 + [3] * 3
    found = _by_height(lower_m, upper_m, pole_of, poles)
    assert found["reason"].tolist() == ["", "", UNEVEN, LOW]
    assert found["kept"].tolist() == [True, True, False, False]


def _panel_sightings(depth_m):
    """A sign at (0, 40) seen from eight places, which takes it for ``depth_m`` away."""
    x = np.linspace(-12.0, 12.0, 8)
    bearing = np.degrees(np.arctan2(-x, 40.0))
    table = pd.DataFrame({"x": x, "y": 0.0, "bearing_grid_deg": bearing, "depth_m": depth_m})
    table["image"] = [f"i{n}" for n in range(8)]
    return table.assign(
        route="r", sequence=range(8), kind="sign", sigma_bearing_deg=0.2,
        sigma_depth_m=0.5 * table["depth_m"], kept=True, anchored=False,
    )  # fmt: skip


@pytest.mark.parametrize("far", [0, 6, 8])
def test_panels_that_seem_too_far_are_found_once(far):
    depth_m = np.where(np.arange(8) < far, 75.0, 42.0)
    poles, pole_of, _ = site_poles(_panel_sightings(depth_m), TriangulationSettings())
    kept = poles[poles["kept"]]
    assert len(kept) == 1 and np.hypot(kept["x"], kept["y"] - 40.0).iloc[0] < 2.0
    assert (pole_of[far:] == pole_of[far:].max(initial=0)).all()


@pytest.mark.parametrize("thinned", [1, 3])
def test_panels_in_whose_place_the_cloud_shows_a_vehicle_are_withheld(thinned):
    """A vehicle seen from above (no ground below it), a post with its panel, one beside a vehicle,
    a few returns alone, and a pole in a vehicle's place."""
    step = np.arange(-3.0, 3.1, 0.3)
    plan = np.array([[x, y] for x in step for y in step])
    car = np.abs(plan) @ [1 / 0.95, 0] < 1

    def scanned(at, top, height):
        return np.column_stack([plan + at, np.where(top, height, 0.0)])[::thinned]

    alone = [[60.0, 0.0, 0.6], [60.0, 0.3, 0.9], [60.3, 0.0, 1.2]]
    post = [[20.0, 0.0, z] for z in (0.6, 0.9, 1.2, 1.5)]
    panel = [[20.0, y, z] for y in (-0.3, 0.3) for z in (1.5, 1.8)]
    beside = scanned([40.0, 0.0], plan[:, 0] > 0.5, 1.4)
    bare = scanned([20.0, 0.0], np.zeros(len(plan), bool), 0.0)
    voxels = np.concatenate([scanned([0.0, 0.0], car, 1.4), bare, post, panel, beside, alone])
    places = np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 0.0], [60.0, 0.0], [0.0, 0.0]])
    filled = are_filled(places, np.zeros(5), voxels)
    assert filled.tolist() == [True, False, False, False, True]
    assert not are_filled(places, np.full(5, np.nan), voxels).any()
    poles = pd.DataFrame({"kind": ["sign"] * 4 + ["pole"], "kept": True, "reason": ""})
    found = withhold_filled(poles, filled)
    assert found["kept"].tolist() == [False, True, True, True, True]
    assert found["reason"].tolist() == [FILLED, "", "", "", ""]


@pytest.mark.parametrize("voxel_m", [0.05, 0.1, 0.1524, 0.3048, 0.6, 1.0])
def test_what_fills_a_place_does_not_hang_on_the_size_of_voxels(voxel_m):
    """A panel of a dense cloud alone, and a car as wide as the disc; coarse voxels tell nothing."""
    rng = np.random.default_rng(1)

    def voxels(low, high):
        points = rng.uniform(low, high, (8000, 3))
        return (np.unique(np.floor(points / voxel_m), axis=0) + 0.5) * voxel_m

    panel, car = (voxels((-0.45, 0.02, 1.2), (0.45, 0.06, 1.9)), voxels((9, -2, 1.4), (11, 2, 1.5)))
    places = np.array([[0.0, 0.0], [10.0, 0.0]])
    found = are_filled(places, np.zeros(2), np.concatenate([panel, car]))
    assert found.tolist() == [False, voxel_m < 1]


def test_a_panel_needs_more_evidence_than_a_pole():
    """Few views of one thing, whose distances are rough: enough for a pole, not for a sign."""
    rng = np.random.default_rng(1)

    def table(kind, views):
        camera = np.column_stack([np.zeros(views), 12.0 * np.arange(views)])
        gap = np.array([6.0, 12.0 * views + 8.0]) - camera
        away = np.hypot(*gap.T)
        other = rng.uniform(0, 360, 40)
        return pd.DataFrame(
            {
                "image": [*(f"{n:02d}" for n in range(views)), *(f"s{n:02d}" for n in range(40))],
                "route": "a",
                "sequence": np.arange(views + 40),
                "kind": kind,
                "x": [*camera[:, 0], *np.zeros(40)],
                "y": [*camera[:, 1], *(1000.0 + 8.0 * np.arange(40))],
                "bearing_grid_deg": [*np.degrees(np.arctan2(*gap.T)) % 360, *other],
                "depth_m": [*away, *np.full(40, 25.0)],
                "sigma_bearing_deg": 0.3,
                "sigma_depth_m": [*0.5 * away, *np.full(40, 12.0)],
                "kept": True,
                "anchored": False,
            }
        )

    def found(kind, views):
        poles, *_ = site_poles(table(kind, views), TriangulationSettings(calibrate_depth=False))
        return int((poles["y"] < 500).sum())

    assert [found("pole", views) for views in (2, 3, 4)] == [0, 1, 1]
    assert [found("sign", views) for views in (2, 3, 4)] == [0, 0, 1]


def test_an_error_along_the_way_that_near_cameras_share_does_not_average_out():
    """A receiver that is off along a road moves all cameras of a stretch, and its poles."""
    camera = np.column_stack([np.linspace(0.0, 28.0, 8), np.zeros(8)])
    pole = np.array([40.0, 5.0])
    gap = pole - camera
    bearing = np.degrees(np.arctan2(gap[:, 0], gap[:, 1]))
    own = {"sigma_bearing_deg": np.full(8, 0.1), "sigma_depth_m": np.full(8, 2.0)}
    far = TriangulationSettings(calibrate_depth=False, max_distance_m=60.0)
    sigma_m = []
    for drift_m in (0.0, 0.6):
        drift = np.tile([drift_m, 0.0], (8, 1))
        depth = np.hypot(*gap.T)
        rays = make_rays(camera, bearing, depth, image=np.arange(8), drift_m=drift, **own)
        poles, _, _ = triangulate(rays, far)
        assert len(poles) == 1
        sigma_m.append(poles["sigma_major_m"].iloc[0])
    assert sigma_m[1] == pytest.approx(np.hypot(sigma_m[0], 0.6), rel=0.15)


def _mahalanobis2(seed: int, shared: bool) -> float:
    """Squared distance of a pole from the truth, whose cameras look and stand amiss together."""
    rng = np.random.default_rng(seed)
    camera = np.column_stack([np.linspace(0.0, 32.0, 5), np.zeros(5)])
    pole = np.array([45.0, 6.0])
    own_deg, heading_deg, aside_m, ratio = 0.05, 0.15, 0.1, 0.01
    gap = pole - camera
    off_axis = np.arctan2(gap[:, 0], gap[:, 1]) - np.pi / 2
    by_focal = np.degrees(ratio * np.sin(off_axis) * np.cos(off_axis))
    turned = np.column_stack([np.zeros(5), by_focal, np.full(5, heading_deg)])
    aside = np.tile([0.0, -aside_m], (5, 1))
    apart = np.abs(camera[:, :1] - camera[:, 0])
    heading, stand = (np.linalg.cholesky(np.exp(-apart / 100.0)) @ rng.normal(size=(5, 2))).T
    seen = pole - (camera + stand[:, None] * aside)
    bearing = np.degrees(np.arctan2(seen[:, 0], seen[:, 1])) + rng.normal() * by_focal
    bearing += heading_deg * heading + rng.normal(0.0, own_deg, 5)
    across = np.degrees(aside_m * gap[:, 0] / (gap**2).sum(axis=1))
    sigma = np.sqrt(own_deg**2 + (turned**2).sum(axis=1) + across**2)
    away = np.hypot(*gap.T)
    known = {"sigma_bearing_deg": sigma, "sigma_depth_m": np.full(5, 2.0)}
    if shared:
        known |= {"turned_deg": turned, "aside_m": aside, "own_deg": np.full(5, own_deg)}
    rays = make_rays(
        camera, bearing, away + rng.normal(0.0, 2.0, 5), image=np.arange(5), route=np.zeros(5),
        **known,
    )  # fmt: skip
    settings = TriangulationSettings(calibrate_depth=False, sigma_position_m=0.01)
    noise = stated_noise(settings)
    noise.variances[[1, 5]] = 1e-8
    places, covariances = place_groups(rays, [np.arange(5)], pole[None], noise, settings)
    return float((places[0] - pole) @ np.linalg.solve(covariances[0], places[0] - pole))


def test_ellipses_hold_poles_whose_cameras_look_and_stand_amiss_together():
    """Sixteen hundred drives past one pole; errors that are shared are not averaged away."""
    inside = {
        shared: np.mean([_mahalanobis2(seed, shared) < 5.991 for seed in range(1600)])
        for shared in (True, False)
    }
    assert 0.935 < inside[True] < 0.965
    assert inside[False] < 0.8


def _covariance(camera, pole, known, route=None, depth_ratio=1.0):
    """Covariance (2, 2) of a pole whose rays all have an error of 0.05 degrees of their own."""
    gap, n = pole - camera, len(camera)
    bearing = np.degrees(np.arctan2(gap[:, 0], gap[:, 1]))
    known = {"own_deg": np.full(n, 0.05)} | known
    rays = make_rays(
        camera, bearing, depth_ratio * np.hypot(*gap.T), np.full(n, 0.5), np.full(n, 20.0),
        image=np.arange(n), route=np.zeros(n) if route is None else route, **known,
    )  # fmt: skip
    settings = TriangulationSettings(calibrate_depth=False, sigma_position_m=0.01)
    return place_groups(rays, [np.arange(n)], pole[None], stated_noise(settings), settings)[1][0]


def test_a_lens_turns_what_lies_left_and_right_of_its_axis_apart():
    """Two cameras at one place that see a pole on either side of their axes undo each other."""
    camera, pole = np.array([[0.0, 0.0], [0.1, 0.0]]), np.array([0.0, 30.0])
    turned = np.zeros((2, 3))
    turned[:, 1] = 0.3, 0.3
    alike = _covariance(camera, pole, {"turned_deg": turned})[0, 0]
    turned[1, 1] = -0.3
    apart = _covariance(camera, pole, {"turned_deg": turned})[0, 0]
    assert alike > 5.0 * apart


@pytest.mark.parametrize("part", [0, 1, 2])
def test_what_turns_one_drive_does_not_turn_another(part):
    camera, pole = np.array([[0.0, 0.0], [0.1, 0.0]]), np.array([0.0, 30.0])
    turned = np.zeros((2, 3))
    turned[:, part] = 0.3
    one = _covariance(camera, pole, {"turned_deg": turned})[0, 0]
    two = _covariance(camera, pole, {"turned_deg": turned}, np.arange(2))[0, 0]
    assert one == pytest.approx(2.0 * two, rel=0.1)


def test_a_lens_is_a_drives_however_long_it_is_and_a_heading_is_not():
    """Two cameras 200 m apart, between which a pole stands."""
    camera, pole = np.array([[-100.0, 0.0], [100.0, 0.0]]), np.array([0.0, 0.0])

    def across(part):
        turned = np.zeros((2, 3))
        # The ways are opposite: what turns both alike moves their points apart.
        turned[:, part] = 0.3, -0.3
        return _covariance(camera, pole, {"turned_deg": turned})[1, 1]

    assert across(1) > 1.5 * across(2)


def test_depths_that_are_too_long_take_nothing_from_a_rays_own_error():
    camera, pole = np.array([[0.0, 0.0], [0.1, 0.0]]), np.array([0.0, 30.0])
    aside = {"aside_m": np.tile([0.1, 0.0], (2, 1)), "own_deg": np.full(2, 0.5)}
    right, long = (_covariance(camera, pole, aside, depth_ratio=k)[0, 0] for k in (1.0, 1.5))
    assert long > right > (30.0 * np.radians(0.5)) ** 2 / 2


def test_shared_errors_of_a_table_reach_its_poles():
    camera = np.column_stack([np.linspace(0.0, 20.0, 6), np.zeros(6)])
    gap = np.array([25.0, 6.0]) - camera
    table = pd.DataFrame(
        {
            "image": [f"{i}.jpg" for i in range(6)], "route": "r", "sequence": np.arange(6),
            "kind": "pole", "x": camera[:, 0], "y": camera[:, 1],
            "bearing_grid_deg": np.degrees(np.arctan2(*gap.T)) % 360, "depth_m": np.hypot(*gap.T),
            "sigma_bearing_deg": 0.5, "sigma_depth_m": 2.0, "kept": True,
        }
    )  # fmt: skip
    nothing = {name: 0.0 for parts in SHARED_COLUMNS.values() for name in parts}
    nothing[OWN_COLUMN] = 0.1

    def axes_m(**shared):
        poles, *_ = site_poles(
            table.assign(**nothing | shared), TriangulationSettings(calibrate_depth=False)
        )
        return poles[["sigma_major_m", "sigma_minor_m"]].iloc[0].tolist()

    before_m = axes_m()
    for name in nothing:
        # Rays look east, and so does the ellipse: a place that is off to the north makes it wider.
        number = 1 if "north" in name else 0
        assert axes_m(**{name: 0.6})[number] > 1.02 * before_m[number], name


def test_ways_out_and_back_do_not_cancel():
    """Errors along the way are each drive's own, and turn round with it on a hairpin."""
    x = np.r_[np.linspace(0.0, 25.0, 6), np.linspace(80.0, 55.0, 6)]
    camera = np.column_stack([x, np.zeros(12)])
    gap = np.array([40.0, 5.0]) - camera
    bearing = np.degrees(np.arctan2(gap[:, 0], gap[:, 1]))
    own = {"sigma_bearing_deg": np.full(12, 0.1), "sigma_depth_m": np.full(12, 0.5)}
    far = TriangulationSettings(calibrate_depth=False, max_distance_m=60.0)

    def sigma_m(back: float, routes: list[str]) -> float:
        drift = np.zeros((12, 2))
        drift[:6, 0], drift[6:, 0] = 0.6, back
        depth, image = np.hypot(*gap.T), np.arange(12)
        route = np.repeat(routes, 6)
        rays = make_rays(camera, bearing, depth, image=image, route=route, drift_m=drift, **own)
        (found,) = triangulate(rays, far)[0]["sigma_major_m"]
        return float(found)

    one_way, hairpin = sigma_m(0.6, ["a", "a"]), sigma_m(-0.6, ["a", "a"])
    two = sigma_m(-0.6, ["a", "b"])
    assert hairpin == pytest.approx(one_way)
    assert two == pytest.approx(sigma_m(0.6, ["a", "b"]))
    assert 0.6 / np.sqrt(2) * 0.8 < two < one_way
