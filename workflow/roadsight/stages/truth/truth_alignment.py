"""Cameras of photographs with a known lens on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bytes, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import EdgeTracing, Reach
from roadsight.evidence.labelled_clouds import Street, read_street
from roadsight.evidence.truth_catalogue import Figure
from roadsight.geometry.cameras import attitude_deg, wrap_deg
from roadsight.io.images.image_shards import LabelImages
from roadsight.io.images.videologs import ImageSource
from roadsight.poles.alignment.dense import YAW, DenseTask, GivenLens, align_dense, moved
from roadsight.poles.alignment.drive import Place, image_edges_of, near_edges, sight_of
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import FOCAL, HEIGHT, INSETS, PITCH, ROLL, Start, pose_of
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.poles.alignment.solve import ImageEdges, Noise, Task
from roadsight.poles.alignment.track import extended_track
from roadsight.poles.alignment.verdict import Limits, dense_doubt, doubt, sigmas, too_little
from roadsight.poles.alignment.visible import SceneCloud
from roadsight.poles.calibration.calibration import weak_mount
from roadsight.poles.images.evidence import ImageEvidence
from roadsight.poles.images.image_edges import BORDER, LANE, trace_edges
from roadsight.poles.images.networks import LabelMap, folder_mask, merge_masks
from roadsight.poles.images.pole_masks import find_instances
from roadsight.poles.sightings.lidar_poles import PoleColumns, find_pole_columns
from roadsight.scene.grids import Grid, fill_gaps, sample_bilinear
from roadsight.scene.pavement.road_surface import KnownRoad
from roadsight.scene.whole import ground_of, road_of
from roadsight.stages.truth.truth_stage import measuring

# Cameras of single photographs whose lens is known, beside surveyed ones.
#
# Each photograph starts 2 degrees and 1 m off, as a videolog would put it, and is aligned by
# itself. The peer is the product's alignment with road edges and pole axes, from the same start
# with the same lens. Its input is found in the same cloud and masks.

START_DEG = np.array([2.0, 1.0, 1.0])
"""Yaw, pitch and roll by which a start is off, either way."""

START_M = 1.0
"""The same in plan, in any direction; a street's height is known."""

EXPECTED = np.array([0.71, 0.71, 0.1, 2.0, 1.0, 1.0])
"""One standard deviation of such a start: along, lateral, up (m), yaw, pitch, roll (degrees)."""

RIGHT_DEG = 0.2
"""A heading is right when it is off by less than this."""

_SURE_SIGMA = 1e-4
"""One standard deviation of the logarithm of a focal length that is known."""

_CELL_M = 0.5
"""Cell of the terrain model, as the product's."""

_EDGE_STEP_M = 0.25
"""Spacing of road edge points, as the product's."""

_LABELS = LabelMap(
    labels=20,
    classes={
        **{0: "road", 2: "building", 3: "building", 5: "pole", 6: "sign", 7: "sign"},
        **{8: "vegetation", 10: "sky"},
        **dict.fromkeys(range(11, 19), "vehicle"),
    },
    over=None,
)
"""Label images of the 19 Cityscapes classes, as ``resources/manifests/labels_cityscapes.yaml``."""

_ROAD_LABELS = LabelMap(
    labels=4,
    classes={1: "road", 2: "kerb", 3: "marking"},
    over=("other", "road", "kerb", "marking", "vegetation", "building"),
)
"""Label images of the network for roads, as its manifest."""


@dataclass(frozen=True)
class _Scene:
    """What both methods read of a street."""

    cloud: SceneCloud
    grid: Grid
    ground_m: Floats
    track_m: Floats
    edges: RoadEdges
    columns: PoleColumns

    def height_m(self, x: float, y: float) -> float:
        return float(sample_bilinear(self.grid, self.ground_m, [x], [y])[0])


@dataclass(frozen=True)
class _Aligned:
    """Error, stated sigma and verdict of one photograph by one method."""

    off_deg: float
    sigma_deg: float
    accepted: bool


def measure_alignment(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """Shares of right headings, of all and of accepted ones, and how honest the sigmas are."""
    folder = next(path.parent for path in files if path.name == "frames.laz")
    scene = _scene(read_street(folder))
    ours, peer, used_s = [], [], 0.0
    for number, (image, grey, classes, true, lens) in enumerate(_photographs(folder)):
        start = moved(true, wrong_start(int(dataset[-2:]), number))
        started = time.process_time()
        ours.append(_dense(scene, grey, classes, start, lens, true))
        used_s += time.process_time() - started
        peer.append(_road(scene, image, classes, start, lens, true))
    beside = dict(_shares(peer))
    return [
        Figure(name, own, beside[name] if np.isfinite(beside[name]) else None, used_s)
        for name, own in _shares(ours)
        if np.isfinite(own)
    ]


def wrong_start(street: int, number: int) -> Floats:
    """Offsets (6,) of a start, drawn by street and photograph."""
    random = np.random.default_rng([street, number, 0])
    angle = random.uniform(0, 2 * np.pi)
    place = START_M * np.array([np.cos(angle), np.sin(angle), 0.0])
    return np.concatenate([place, START_DEG * random.choice([-1, 1], 3)])


def _shares(found: Sequence[_Aligned]) -> list[tuple[str, float]]:
    """Figures of one method by name; NaN where no heading was accepted."""
    off = np.abs([one.off_deg for one in found])
    used = np.array([one.accepted for one in found])
    sigma = np.array([one.sigma_deg for one in found])

    def share(of: np.ndarray) -> float:
        return 100 * float(of.mean()) if len(of) else float("nan")

    return [
        ("within_0.2deg", share(off < RIGHT_DEG)),
        ("median_deg", float(np.median(off))),
        ("accepted", share(used)),
        ("accepted_within_0.2deg", share(off[used] < RIGHT_DEG)),
        ("within_1_sigma", share(off[used] < sigma[used])),
        ("within_2_sigma", share(off[used] < 2 * sigma[used])),
    ]


def _dense(
    scene: _Scene, grey: Bytes, classes: Bytes, start: Floats, lens: GivenLens, true: Floats
) -> _Aligned:
    evidence = ImageEvidence(grey, classes)
    task = DenseTask(scene.cloud, evidence, lens, start, np.diag(EXPECTED**2))
    fit = align_dense(task)
    reason = dense_doubt(task, fit, Limits())
    return _Aligned(_off(fit.pose[YAW], true), float(fit.sigma[YAW]), not reason)


def _road(
    scene: _Scene, image: str, classes: Bytes, start: Floats, lens: GivenLens, true: Floats
) -> _Aligned:
    """The same by road edges and pole axes."""
    x, y, z, heading, pitch, roll = start
    road_m = scene.height_m(x, y)
    size = classes.shape[1], classes.shape[0]
    centre = lens.cx_px, lens.cy_px
    track = extended_track(scene.track_m, 60.0)
    place = Place(image, "", 0.0, Start(x, y, road_m, heading, 0.0, 0.0, *size, *centre), track)
    prior = weak_mount(None, size[0])
    mean, variance = prior.mean.copy(), np.diag(prior.covariance).copy()
    mean[:INSETS] = 0.0
    mean[[HEIGHT, PITCH, ROLL, FOCAL]] = z - road_m, pitch, roll, np.log(lens.focal_px)
    variance[:INSETS] = np.r_[EXPECTED, _SURE_SIGMA, _SURE_SIGMA] ** 2
    seen, reach = _image_edges(classes), Reach()
    there = near_edges(place, scene.edges, reach)
    noise = LandmarkNoise()
    sight = sight_of(place, _pole_axes(classes), scene.columns, noise)
    task = Task(place.start, seen, there, Noise(), mean, np.diag(1 / variance), sight)
    reason = too_little(task, Limits())
    if reason:
        return _Aligned(_off(heading, true), float(EXPECTED[YAW]), False)
    fits = locate(task, noise)
    found = pose_of(place.start, fits[0].unknowns).heading_deg
    reason = doubt(task, fits, Limits())
    return _Aligned(_off(found, true), sigmas(fits[0], task)[0], not reason)


def _off(heading_deg: float, true: Floats) -> float:
    return float(wrap_deg(heading_deg - true[YAW]))


def _photographs(folder: Path) -> list[tuple[str, Bytes, Bytes, Floats, GivenLens]]:
    """Name, photograph, classes, pose and lens of each photograph of a street."""
    table = pd.read_csv(folder / "truth_cameras.csv")
    images = ImageSource(folder / "images")
    sources = (
        (LabelImages(folder / "masks"), _LABELS),
        (LabelImages(folder / "road_masks"), _ROAD_LABELS),
    )
    names = [f"cam_from_world_r{i}{j}" for i in range(3) for j in range(3)]
    found = []
    for _, row in table.iterrows():
        image = str(row["image"])
        photograph = images.read(image)
        grey = np.asarray(cv2.cvtColor(photograph, cv2.COLOR_BGR2GRAY), np.uint8)
        masks = [
            folder_mask(labels.read(image), about, grey.shape[:2], str(labels.folder))
            for labels, about in sources
        ]
        classes = merge_masks(masks, [about for _, about in sources])
        turn = row[names].to_numpy(np.float64).reshape(3, 3)
        angles = [float(angle) for angle in attitude_deg(turn)]
        place = row[["x_m", "y_m", "z_m"]].to_numpy(np.float64)
        lens = GivenLens(float(row["fx_px"]), float(row["cx_px"]), float(row["cy_px"]))
        found.append((image, grey, classes, np.append(place, angles), lens))
    return found


def _scene(street: Street) -> _Scene:
    """Cloud over its terrain model, road edges and pole-like columns."""
    xyz = street.xyz_m
    ground = ground_of(xyz)
    x, y, z = xyz[ground].T
    grid = Grid.around(xyz[:, 0], xyz[:, 1], _CELL_M)
    cells = grid.rows * grid.columns
    count = np.bincount(grid.flat(x, y), minlength=cells)
    total = np.bincount(grid.flat(x, y), z, cells)
    with np.errstate(invalid="ignore"):
        height = fill_gaps((total / np.where(count > 0, count, np.nan)).reshape(grid.shape))
    below = sample_bilinear(grid, height, xyz[:, 0], xyz[:, 1])
    cloud = SceneCloud.of(xyz, street.intensity, below)
    columns = find_pole_columns(xyz, xyz[:, 2] - below, np.ones(len(xyz), np.uint8))
    return _Scene(cloud, grid, height, street.scanner_m[:, :2], _road_edges(street), columns)


def _road_edges(street: Street) -> RoadEdges:
    """Edges of the road that the product finds; none where it finds no road."""
    track = street.scanner_m[:, :2]
    try:
        road, _ = road_of(street.xyz_m, street.intensity, street.scan, KnownRoad(track_xy=track))
    except InputError:
        return RoadEdges.from_points(np.empty((0, 3)))
    rings = [
        ring for polygon in road.outline.geoms for ring in (polygon.exterior, *polygon.interiors)
    ]
    xy = np.concatenate(
        [
            np.array(
                [line.interpolate(s).coords[0] for s in np.arange(0, line.length, _EDGE_STEP_M)]
            )
            for line in rings
        ]
    )
    nearest = cKDTree(road.surface_m[:, :2]).query(xy)[1]
    return RoadEdges.from_points(np.column_stack([xy, road.surface_m[nearest, 2]]))


def _image_edges(classes: Bytes) -> ImageEdges:
    found = trace_edges(classes, EdgeTracing(borders="nearest"))
    rows = pd.DataFrame(
        {
            "u": found.uv_px[:, 0],
            "v": found.uv_px[:, 1],
            "side": found.side,
            "kind": np.where(found.is_lane, LANE, BORDER),
        }
    )
    return image_edges_of(rows, Reach())


def _pole_axes(classes: Bytes) -> pd.DataFrame:
    """Axes of the poles in a mask, as the table of pole axes has them."""
    rows = []
    for one in find_instances(classes):
        if one.reason:
            continue
        middle = 0.5 * (one.v_min + one.v_foot)
        rows.append(
            {
                "view": "front",
                "u": float(one.axis_u(np.array(middle))),
                "v": middle,
                "slope": one.slope,
                "v_foot": one.v_foot,
                "v_top": one.v_min,
                "width_px": one.width_px,
                "width_view_px": classes.shape[1],
                "height_view_px": classes.shape[0],
                "foot_visible": one.foot == "visible",
                "top_cut": "top" in one.cut,
            }
        )
    return pd.DataFrame(rows)


main = measuring(measure_alignment, __doc__)


if __name__ == "__main__":
    sys.exit(main())
