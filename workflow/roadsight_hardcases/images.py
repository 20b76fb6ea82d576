"""Masks, depth maps, edges and poles in images."""

from __future__ import annotations

import cv2
import numpy as np

from roadsight.geometry.cameras import Intrinsics, cam_from_world
from roadsight.poles.images.image_edges import trace_edges
from roadsight.poles.images.image_matches import agreed_turn, features, matched, turn_votes
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.lanes import fit_curve
from roadsight.poles.images.networks import LabelMap, folder_mask, packed_depth
from roadsight.poles.images.pole_masks import find_instances
from roadsight.poles.images.views import turned
from roadsight.poles.sightings.distances import ground_distances, sample_depth
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight_hardcases.case import Errors, fails, hard_case


@hard_case("segment_images", bound=0.5, unit="pixels of a class that is not there")
def labels_are_no_quantities(rng: np.random.Generator) -> Errors:
    """Resizing a label image by interpolation makes class 3 between classes 1 and 5."""
    small = np.where(rng.random((40, 60)) < 0.5, 1, 5).astype(np.uint8)
    naive = cv2.resize(small, (240, 160), interpolation=cv2.INTER_LINEAR)
    labels = LabelMap(labels=6, classes={1: "road", 3: "kerb", 5: "vegetation"}, over=None)
    ours = folder_mask(small, labels, (160, 240), "case")
    return np.count_nonzero(naive == 3), np.count_nonzero(ours == PixelClass.KERB)


@hard_case("estimate_depth", bound=0.02, unit="share of the depth")
def depth_in_8_bits(rng: np.random.Generator) -> Errors:
    """256 steps of inverse depth leave nothing between 40 m and 60 m."""
    depth_m = np.linspace(40.0, 60.0, 400)
    inverse = np.append(1 / depth_m, 1 / 2.0)[None]
    low, high = inverse.min(), inverse.max()
    shares = (
        np.round((inverse - low) / (high - low) * 255) / 255,
        (packed_depth(inverse, metric=False) - 1.0) / 65534,
    )
    naive, ours = (1 / (low + share[0, :-1] * (high - low)) for share in shares)
    return np.abs(naive / depth_m - 1).max(), np.abs(ours / depth_m - 1).max()


@hard_case("estimate_depth", bound=0.5, unit="pixels of made-up depth")
def depth_map_without_contrast(rng: np.random.Generator) -> Errors:
    """A constant depth map stretched to its own range is zero over zero, cast to a number."""
    constant = np.add(0.25, rng.normal(0, 1e-8, (30, 40)), dtype=np.float32)
    scaled = (constant - constant.min()) / (constant.max() - constant.min())
    naive = (scaled * 65535).astype(np.uint16)
    return np.count_nonzero(naive), np.count_nonzero(packed_depth(constant, metric=False))


@hard_case("trace_image_edges", bound=0.5, unit="images that break it")
def masks_without_a_road(rng: np.random.Generator) -> Errors:
    """A mask without road, without markings, or all road, gives a line fit nothing to fit."""
    naive = ours = 0.0
    for value in (PixelClass.OTHER, PixelClass.ROAD, PixelClass.SKY):
        mask = np.full((120, 160), int(value), np.uint8)
        row, column = np.nonzero(mask == PixelClass.MARKING)
        naive += fails(np.polyfit, row, column, 1)
        ours += fails(trace_edges, mask)
    return naive, ours


@hard_case("trace_image_edges", bound=1.0, unit="px")
def marking_straight_down(rng: np.random.Generator) -> Errors:
    """Row as a function of column has no slope where a marking runs straight down the image."""
    v = np.linspace(600, 1100, 400)
    u = 812.0 + rng.normal(0, 0.4, 400)
    slope, level = np.polyfit(u, v, 1)
    curve = fit_curve(np.column_stack([u, v]), 2.0)
    ours = np.inf if curve is None else np.abs(curve.at(v) - 812).max()
    return np.abs((v - level) / slope - 812).max(), min(ours, 1e6)


@hard_case("match_images", bound=0.05, unit="share of matches that are wrong")
def a_fence_among_other_things(rng: np.random.Generator) -> Errors:
    """Every picket of a fence looks like the next one: what is most alike is often another one."""
    wide = np.full((220, 500), 130, np.uint8)
    wide[:130] = cv2.resize(rng.integers(0, 255, (26, 100), np.uint8), (500, 130))
    for left in range(6, 500, 14):
        cv2.rectangle(wide, (left, 150), (left + 4, 205), 240, -1)
    grain = rng.normal(0, 2.0, (2, 220, 420))
    views = [wide[:, 40:460] + grain[0], wide[:, 20:440] + grain[1]]
    one, other = (features(np.clip(view, 0, 255).astype(np.uint8)) for view in views)
    nearest = (one.descriptors @ other.descriptors.T).argmax(axis=1)
    pairs = np.column_stack([np.arange(len(nearest)), nearest])
    shares = []
    for found in (pairs, matched(one, other)):
        moved = other.uv_px[found[:, 1]] - one.uv_px[found[:, 0]]
        shares.append(float(np.mean(np.abs(moved - [20, 0]).max(axis=1) > 2.0)))
    return shares[0], shares[1] if len(matched(one, other)) > 30 else 1.0


@hard_case("turn_side_views", bound=0.3, unit="deg")
def most_matches_of_a_side_view_are_wrong(rng: np.random.Generator) -> Errors:
    """Each match gives two yaws and leaves look like other leaves: the mean yaw is no yaw."""
    true_deg, way_m = 21.0, np.array([0.0, 8.0, 0.0])
    front = cam_from_world(0.0, 0.0, 0.0)
    beside = np.radians(0.6 * true_deg + rng.uniform(-6, 6, 400))
    far_m = rng.uniform(15, 60, 400)
    points = np.column_stack(
        [far_m * np.sin(beside), far_m * np.cos(beside), rng.uniform(-2, 8, 400)]
    )
    sides = (points - way_m) @ turned(front, true_deg).T
    mixed = np.flatnonzero(rng.random(400) < 0.6)
    sides[mixed] = sides[rng.permutation(mixed)]
    votes = turn_votes(points, way_m, sides, front)
    usual = float(np.mean(votes.turn_deg[np.abs(votes.turn_deg) < 90.0]))
    return abs(usual - true_deg), abs(agreed_turn(votes)[0] - true_deg)


@hard_case("trace_pole_axes", bound=0.5, unit="poles lost")
def more_than_255_components(rng: np.random.Generator) -> Errors:
    """OpenCV writes component numbers to a PNG in 8 bits: all from 255 on become one object."""
    mask = np.zeros((400, 2400), np.uint8)
    mask[100:160, 4:2400:8] = int(PixelClass.POLE)
    mask[100:160, 5:2400:8] = int(PixelClass.POLE)
    true, labels = cv2.connectedComponents((mask > 0).astype(np.uint8))
    written = cv2.imdecode(cv2.imencode(".png", labels)[1], cv2.IMREAD_UNCHANGED)
    naive = 0 if written is None else len(np.unique(written)) - 1
    return true - 1 - naive, true - 1 - len(find_instances(mask))


@hard_case("measure_poles", bound=1.0, unit="m")
def foot_below_the_image(rng: np.random.Generator) -> Errors:
    """The lower end of a pole that the image's edge cuts is not its foot."""
    mask = np.full((1200, 1920), int(PixelClass.SKY), np.uint8)
    mask[640:] = int(PixelClass.ROAD)
    mask[200:1200, 1700:1716] = int(PixelClass.POLE)
    mask[300:1000, 400:416] = int(PixelClass.POLE)  # this one's foot is in the image
    camera = ViewCamera(Intrinsics.centred(1920, 1200, 1000.0), (0.0, 0.0, 2.2), 0.0)
    found = [one for one in find_instances(mask) if not one.reason]
    drop = (1199.5 - camera.intrinsics.cy_px) / camera.intrinsics.focal_px
    aside = (1707.5 - camera.intrinsics.cx_px) / camera.intrinsics.focal_px
    true_m = 2.5 * np.hypot(1, aside)  # nearer than the picture shows
    naive = 2.2 / drop * np.hypot(1, aside)
    ours, _ = ground_distances(camera, found, lambda x, y: np.zeros(len(x)), 8.0, 0.1, 60.0)
    left = np.array([one.u_foot < 960 for one in found])
    # Where the foot is not seen, no distance follows from it.
    off = ours[left] - 2.2 * np.hypot(1000.0, 407.5 - 959.5) / (999.5 - 599.5)
    given = ours[~left][np.isfinite(ours[~left])] - true_m
    return abs(naive - true_m), np.abs(np.append(off, given)).max()


@hard_case("measure_poles", bound=0.5, unit="depths read at another place")
def foot_beside_the_image(rng: np.random.Generator) -> Errors:
    """A pixel left of the image is minus one: indexing takes the depth at the right border."""
    depth = np.tile(np.linspace(1, 65535, 64).astype(np.uint16), (48, 1))
    uv = np.array([[-3.0, 10.0], [np.nan, 5.0], [5.0, -8.0], [20.0, 30.0]])
    index = np.nan_to_num(np.round(uv)).astype(int)
    naive = depth[index[:3, 1], index[:3, 0]]
    ours = np.isfinite(sample_depth(depth, uv, depth.shape))
    return np.count_nonzero(naive), np.count_nonzero(ours != [False, False, False, True])
