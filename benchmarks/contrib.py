"""What opencv-contrib does beside what is used here: ``python -m benchmarks.contrib``.

Reads the labelled streets and the videologs under ROADSIGHT_DATA. The tables of
docs/decisions/104-opencv-contrib.md were printed by it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import laspy
import numpy as np
import pandas as pd

from roadsight.base.sections.poles import EdgeTracing
from roadsight.io.images.models import read_label_map
from roadsight.poles.images.image_edges import _borders, _cleaned_road
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.lanes import centre_lines
from roadsight.poles.images.pole_masks import Instance, find_instances

LABELS = Path("resources/manifests/labels_cityscapes.yaml")
HALVES = {"chosen on": ("02", "05", "07"), "reported": ("03", "06", "08")}
"""Streets on which parameters were chosen, and those that are reported."""
_POLE = int(PixelClass.POLE)
_POLE_LABEL = 80
"""Of a pole in the labels of street_scans."""
_RANGE_M = (2.0, 60.0)
"""Ranges of labelled points that count."""
_NEAR_PX = 6.0
"""Points of a pole lie within this of the axis of its mask."""

Image = np.ndarray
Smoother = Callable[[Image, Image], Image]
Axis = Callable[[Instance, Image, Image], Instance]


@dataclass
class View:
    """A photograph, its classes by a network, and the points of poles in it: (n, 2) as u, v."""

    image: Image
    classes: Image
    points: np.ndarray


def views(street: Path) -> Iterator[View]:
    """Photographs of a labelled street; points are of the scan of the same moment."""
    las = laspy.read(street / "frames.laz")
    xyz, scan = np.asarray(las.xyz), np.asarray(las.point_source_id)
    pole = np.load(street / "labels.npz")["label"] == _POLE_LABEL
    lookup = read_label_map(LABELS).lookup()
    for camera in pd.read_csv(street / "truth_cameras.csv").to_dict("records"):
        rotation = np.array([camera[f"cam_from_world_r{i}{j}"] for i in range(3) for j in range(3)])
        offset = xyz[pole & (scan == camera["frame"])] - [camera[f"{axis}_m"] for axis in "xyz"]
        x, y, z = rotation.reshape(3, 3) @ offset.T
        u = camera["fx_px"] * x / z + camera["cx_px"]
        v = camera["fy_px"] * y / z + camera["cy_px"]
        inside = (z > _RANGE_M[0]) & (z < _RANGE_M[1])
        inside &= (np.abs(u / camera["width_px"] - 0.5) < 0.5) & (v > 0)
        inside &= v < camera["height_px"]
        stem = Path(camera["image"]).stem
        labels = cv2.imread(str(street / "masks" / f"{stem}.png"), cv2.IMREAD_UNCHANGED)
        image = cv2.imread(str(street / "images" / camera["image"]))
        yield View(image, lookup[labels], np.column_stack([u, v])[inside])


SMOOTHERS: dict[str, Smoother] = {
    "as the network gave it": lambda image, own: own > 0,
    "guidedFilter": lambda image, own: (
        cv2.ximgproc.guidedFilter(image, own, 4, 1e-3 * 255**2) > 127
    ),
    "fastGlobalSmootherFilter": lambda image, own: (
        cv2.ximgproc.fastGlobalSmootherFilter(image, own, 100, 3) > 127
    ),
    "medianBlur (plain OpenCV)": lambda image, own: cv2.medianBlur(own, 5) > 127,
}
"""Ways to bring the mask of poles to the photograph's edges; of each the best of up to 18 settings,
by IoU on the streets chosen on."""


def beside(found: Instance, lines: Image | None, left: int, top: int) -> Instance:
    """An object with the axis between the two lines that bound its mask, if there are such."""
    if lines is None:
        return found
    ends = lines.reshape(-1, 4).astype(float) + np.array([left, top, left, top])
    rise, run = ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0]
    high = np.abs(rise) > 0.3 * (found.v_max - found.v_min)
    high &= np.abs(run - found.slope * rise) < 0.06 * np.abs(rise) + 1
    ends, slope = ends[high], run[high] / rise[high]
    middle = 0.5 * (found.v_min + found.v_foot)
    u = ends[:, 0] + slope * (middle - ends[:, 1])
    aside = u - found.axis_u(np.array([middle]))[0]
    pairs = [
        (abs(aside[i] + aside[j]), i, j)
        for i in np.flatnonzero(aside < 0)
        for j in np.flatnonzero(aside >= 0)
        if 0.4 * found.width_px <= aside[j] - aside[i] <= 1.8 * found.width_px + 1
    ]
    if not pairs:
        return found
    _, i, j = min(pairs)
    between = float(slope[[i, j]].mean())
    foot = float(u[[i, j]].mean() + between * (found.v_foot - middle))
    return replace(found, slope=between, u_foot=foot)


def box(found: Instance, image: Image) -> tuple[Image, int, int]:
    """What lies around an object, its column and its row."""
    left, top = max(int(found.u_min) - 4, 0), max(int(found.v_min) - 4, 0)
    part = image[top : int(found.v_max) + 5, left : int(found.u_max) + 5]
    return np.ascontiguousarray(part), left, top


def fast_lines(found: Instance, image: Image, classes: Image) -> Instance:
    """Axis by the lines of `FastLineDetector` in the mask."""
    part, *corner = box(found, (classes == _POLE).view(np.uint8) * np.uint8(255))
    detector = cv2.ximgproc.createFastLineDetector(length_threshold=10)
    return beside(found, detector.detect(part), *corner)


def drawn_lines(found: Instance, image: Image, classes: Image) -> Instance:
    """Axis by the lines of `EdgeDrawing` in the photograph."""
    part, *corner = box(found, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    drawing = cv2.ximgproc.createEdgeDrawing()
    drawing.detectEdges(part)
    return beside(found, drawing.detectLines(), *corner)


AXES: dict[str, Axis] = {
    "rows of the mask (ours)": lambda found, image, classes: found,
    "FastLineDetector on the mask": fast_lines,
    "EdgeDrawing on the photograph": drawn_lines,
}


def poles(shown: list[View], smoother: Smoother, axis: Axis) -> str:
    """Objects whose axis meets labelled points of poles, and how far they lie from it."""
    aside, met, found, others, took_s = [], 0, 0, 0, 0.0
    for view in shown:
        begun = time.process_time()
        own = smoother(view.image, (view.classes == _POLE).view(np.uint8) * np.uint8(255))
        classes = view.classes.copy()
        classes[(view.classes == _POLE) & ~own] = PixelClass.OTHER
        classes[own] = _POLE
        took_s += time.process_time() - begun
        objects = [one for one in find_instances(classes) if not one.reason]
        begun = time.process_time()
        objects = [axis(one, view.image, classes) for one in objects]
        took_s += time.process_time() - begun
        u, v = view.points.T
        taken = np.zeros(len(u), bool)
        for one in objects:
            off = u - one.axis_u(v)
            own = (v > one.v_min - 2) & (v < one.v_foot + 3)
            own &= np.abs(off) < max(_NEAR_PX, one.width_px)
            if own.sum() >= 3:
                aside.append(abs(np.median(off[own])))
                taken |= own
            else:
                others += 1
        met, found = met + taken.sum(), found + len(u)
    return (
        f"{len(aside)} objects on poles, {others} others, {met / found:.1%} of the points of poles,"
        f" {np.median(aside):.2f} px off (80 %: {np.percentile(aside, 80):.2f}),"
        f" {1e3 * took_s / len(shown):.0f} ms an image"
    )


def lines() -> None:
    """Known borders and centre-lines, against edge drawing and thinning."""
    settings, errors = EdgeTracing(), {}
    for number in range(20):
        slope, start = 0.1 + 0.05 * number, 100.37 + 3.1 * number
        v, u = np.mgrid[:400, :600]
        mask = (u < start + slope * v).astype(np.uint8)
        band = mask.astype(bool) & (u >= start - 7 + slope * v)

        def off(points: Image, shift: float, slope: float = slope, start: float = start) -> float:
            across = points[:, 0] - start + shift - slope * points[:, 1]
            return float(np.mean(np.abs(across)) / np.hypot(1, slope))

        drawing = cv2.ximgproc.createEdgeDrawing()
        drawing.detectEdges(mask * np.uint8(255))
        thin = cv2.ximgproc.thinning(band.view(np.uint8) * np.uint8(255))
        for name, found, shift in (
            ("border, ours", _borders(mask * 0, _cleaned_road(mask, settings), settings), 0.0),
            ("border, EdgeDrawing", np.argwhere(drawing.getEdgeImage())[:, ::-1], 0.0),
            ("centre-line, ours", centre_lines(band, settings.min_marking_px), 3.5),
            ("centre-line, thinning", np.argwhere(thin)[:, ::-1], 3.5),
        ):
            errors.setdefault(name, []).append(off(np.asarray(found, float), shift))
    for name, found in errors.items():
        print(f"{name}: {np.mean(found):.2f} px off")


def hashes(folders: list[Path]) -> None:
    """How far copies of an image, and the images of neighbouring places, are from each other."""
    kinds = {
        "MarrHildrethHash": cv2.img_hash.MarrHildrethHash.create(),
        "BlockMeanHash": cv2.img_hash.BlockMeanHash.create(1),
        "PHash": cv2.img_hash.PHash.create(),
        "AverageHash": cv2.img_hash.AverageHash.create(),
    }
    for folder in folders:
        images = [cv2.imread(str(file)) for file in sorted(folder.iterdir())]
        for name, kind in kinds.items():
            begun = time.process_time()
            own = [kind.compute(image) for image in images]
            each_ms = 1e3 * (time.process_time() - begun) / len(images)
            apart = [kind.compare(a, b) for a, b in pairwise(own)]
            copies = [
                kind.compare(own[number], kind.compute(copy))
                for number in range(0, len(images), 5)
                for copy in copied(images[number])
            ]
            print(
                f"{folder.parent.name}, {name}: copies {max(copies):.0f} bits at most, neighbours"
                f" {min(apart):.0f} at least, {each_ms:.1f} ms an image"
            )


def copied(image: Image) -> list[Image]:
    """An image that was stored anew, and one with another line of text in it."""
    _, stored = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 50])
    text = image.copy()
    place = 10, image.shape[0] - 12
    cv2.putText(text, "12:34:56.7 35.123N", place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255))
    return [cv2.imdecode(stored, cv2.IMREAD_COLOR), text]


def main(data: Path) -> int:
    """Print a line for each."""
    cv2.setNumThreads(1)
    lines()
    for half, streets in HALVES.items():
        shown = [view for street in streets for view in views(data / "street_scans" / street)]
        for name, smoother in SMOOTHERS.items():
            print(f"{half}, {name}: {poles(shown, smoother, AXES['rows of the mask (ours)'])}")
        for name, axis in AXES.items():
            print(f"{half}, {name}: {poles(shown, SMOOTHERS['as the network gave it'], axis)}")
    drives = [data / "videolog" / name / "images" for name in ("kitti_0009", "kitti_04")]
    hashes([*drives, *(data / "street_scans" / street / "images" for street in ("02", "06"))])
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(os.environ["ROADSIGHT_DATA"])))
