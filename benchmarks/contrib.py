"""What opencv-contrib does beside what is written here: ``python -m benchmarks.contrib FOLDER``.

FOLDER holds ``road_masks`` (3: marking), ``masks`` (5: pole) and ``images`` of the same names. The
table of docs/decisions/075-engines-and-kept-libraries.md was printed by it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.sections.poles import EdgeTracing
from roadsight.poles.images.classes import PixelClass
from roadsight.poles.images.evidence import edge_maps
from roadsight.poles.images.image_edges import _borders, _cleaned_road
from roadsight.poles.images.lanes import centre_lines
from roadsight.poles.images.pole_masks import find_instances

_MARKING, _POLE = 3, 5
_MOST = 60
"""Images looked at."""


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """Result and CPU milliseconds, the least of three."""
    times = []
    for _ in range(3):
        begun = time.process_time()
        found = work()
        times.append(1e3 * (time.process_time() - begun))
    return found, min(times)


def apart_px(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distance of each point of ``one`` (n, 2) to the nearest of ``other``."""
    if not len(one) or not len(other):
        return np.full(len(one), np.inf)
    return np.asarray(cKDTree(other).query(one)[0])


def pixels(mask: np.ndarray) -> np.ndarray:
    """Places (n, 2) as u, v of what is set."""
    return np.argwhere(mask)[:, ::-1].astype(float)


def edges_drawn(image: np.ndarray) -> np.ndarray:
    """Edge pixels by edge drawing."""
    drawing = cv2.ximgproc.createEdgeDrawing()
    drawing.detectEdges(image)
    return pixels(drawing.getEdgeImage())


def a_line(slope: float, start: float) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """A mask whose border is a known line, and the distance of points from that line."""
    v, u = np.mgrid[:400, :600]
    mask = (u < start + slope * v).astype(np.uint8)
    return mask, lambda p: np.abs(p[:, 0] - start - slope * p[:, 1]) / np.hypot(1, slope)


def main(folder: Path) -> int:
    """Print a line for each."""
    cv2.setNumThreads(1)
    settings, rows = EdgeTracing(), {"centre": [], "edges": []}
    files = sorted((folder / "road_masks").rglob("*.png"))
    for file in files[:: max(len(files) // _MOST, 1)]:
        mask = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        marking = mask == _MARKING
        if marking.sum() > 200:
            ours, own_ms = timed(lambda m=marking: centre_lines(m, settings))
            theirs, their_ms = timed(
                lambda m=marking: pixels(cv2.ximgproc.thinning(m.view(np.uint8) * 255))
            )
            near = apart_px(theirs, ours)
            rows["centre"].append((own_ms, their_ms, np.median(near), np.mean(near > 2)))
        image = next((folder / "images").rglob(file.stem + ".*"), None)
        if image is not None:
            grey = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
            maps, own_ms = timed(lambda g=grey: sum(edge_maps(g)) > 0)
            theirs, their_ms = timed(lambda g=grey: edges_drawn(g))
            near = apart_px(theirs, pixels(maps))
            rows["edges"].append((own_ms, their_ms, np.median(near), np.mean(near > 2)))
    for name, found in rows.items():
        if found:
            means = np.mean(found, axis=0)
            print(f"{name}: {len(found)} images, ours {means[0]:.1f} ms, theirs {means[1]:.1f} ms,")
            print(f"  theirs {means[2]:.2f} px from ours, {means[3]:.0%} farther than 2 px")
    errors = {"ours": [], "edge drawing": [], "thinning": []}
    for number in range(20):
        mask, off = a_line(0.1 + 0.05 * number, 100.37 + 3.1 * number)
        road = _cleaned_road(mask, settings)
        errors["ours"].append(np.mean(off(_borders(mask * 0, road, settings))))
        drawn = edges_drawn(mask * np.uint8(255))
        errors["edge drawing"].append(np.mean(off(drawn)))
        band, off = a_line(0.1 + 0.05 * number, 100.37 + 3.1 * number)
        wide = (band - a_line(0.1 + 0.05 * number, 93.37 + 3.1 * number)[0]).astype(bool)
        shift = 3.5 / np.hypot(1, 0.1 + 0.05 * number)
        centre = pixels(cv2.ximgproc.thinning(wide.view(np.uint8) * 255))
        errors["thinning"].append(np.mean(np.abs(off(centre) - shift)))
        errors.setdefault("ours, centre line", []).append(
            np.mean(np.abs(off(centre_lines(wide, settings)) - shift))
        )
    for name, found in errors.items():
        print(f"known line, {name}: {np.mean(found):.3f} px off")
    poles(folder)
    return 0


def poles(folder: Path) -> None:
    """Axes of known poles, and how long axes take on real masks."""
    detector = cv2.ximgproc.createFastLineDetector(length_threshold=20)
    errors: dict[str, list[float]] = {"ours": [], "fast line detector": []}
    for number in range(40):
        slope = -0.1 + 0.005 * number
        v, u = np.mgrid[:375, :300]
        own = (np.abs(u - 150.3 - slope * (v - 180)) < 3.4) & (v > 60) & (v < 320)
        mask = np.where(own, np.uint8(PixelClass.POLE), np.uint8(0))
        errors["ours"].append(abs(find_instances(mask)[0].slope - slope))
        lines = detector.detect(own.view(np.uint8) * 255)
        upright = [one for one in lines.reshape(-1, 4) if abs(one[3] - one[1]) > 100]
        slopes = [(one[2] - one[0]) / (one[3] - one[1]) for one in upright]
        errors["fast line detector"].append(abs(np.mean(slopes) - slope) if slopes else np.nan)
    for name, found in errors.items():
        print(f"known pole, {name}: {np.degrees(np.nanmean(found)):.3f} degrees off")
    times = []
    for file in sorted((folder / "masks").rglob("*.png"))[:_MOST]:
        own = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) == _POLE
        mask = np.where(own, np.uint8(PixelClass.POLE), np.uint8(0))
        found, own_ms = timed(lambda m=mask: find_instances(m))
        lines, their_ms = timed(lambda m=own: detector.detect(m.view(np.uint8) * 255))
        times.append((own_ms, their_ms, len(found), 0 if lines is None else len(lines)))
    means = np.mean(times, axis=0)
    print(f"poles: {len(times)} images, ours {means[0]:.1f} ms, theirs {means[1]:.1f} ms,")
    print(f"  {means[2]:.1f} objects in an image, {means[3]:.1f} lines")


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
