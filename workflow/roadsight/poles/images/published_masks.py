"""Poles in a mask by the pole study's rules (section 3.1; numbers of the authors' code).

Numbers in pixels are of an image 1200 px high and are scaled with the height. The authors' labels
are stored in 8 bits, so that the 257th component is the first again; here they are not.
"""

from __future__ import annotations

import cv2
import numpy as np

from roadsight.base.arrays import Bytes
from roadsight.poles.images.classes import PixelClass
from roadsight.poles.images.lanes import scale_of
from roadsight.poles.images.pole_masks import Instance, cut_sides

_WIDER_PX, _TALLER_PX = 10.0, 20.0
"""A pole's box is wider and taller than this."""
_ASPECT = 10.0
"""Height over width from which a component is a pole as it is; below it, what is as long for its
width across its own axes is one after its wires are removed."""
_KERNEL_PX = 10
"""Side of the square by which wires are removed."""


def published_instances(mask: Bytes) -> list[Instance]:
    """Poles in a mask (rows, columns) of project classes, left to right.

    The foot is in the lowest row of a component, in the column of its centroid. Rules that need the
    distance are those of `sightings`. All components are given; ``reason`` says which are no poles.
    """
    scale = scale_of(mask.shape[0])
    poles = (mask == PixelClass.POLE).view(np.uint8)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    signs = cv2.dilate((mask == PixelClass.SIGN).view(np.uint8), cross)
    count, labels, stats, centres = cv2.connectedComponentsWithStats(
        poles, connectivity=8, ltype=cv2.CV_32S
    )
    side = max(round(_KERNEL_PX * scale), 2)
    found = []
    for number in range(1, count):
        left, top, width, height, pixels = (int(value) for value in stats[number])
        box = slice(top, top + height), slice(left, left + width)
        own = (labels[box] == number).view(np.uint8)
        u_foot, reason = float(centres[number, 0]), ""
        if width <= _WIDER_PX * scale or height <= _TALLER_PX * scale:
            reason = "too small"
        elif height / width < _ASPECT:
            if _elongation(own) < _ASPECT:
                reason = "not slender"
            else:
                # A margin of nothing, so that the frame of the box holds nothing back.
                wide = np.pad(own, side)
                thick = cv2.morphologyEx(wide, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
                columns = np.flatnonzero(thick.any(axis=0))
                reason = "" if len(columns) else "wires alone"
                if len(columns):
                    u_foot = float(np.argwhere(thick)[:, 1].mean()) - side + left
        found.append(
            Instance(
                kind="pole",
                u_foot=u_foot,
                v_foot=top + height - 0.5,
                u_min=left - 0.5,
                v_min=top - 0.5,
                u_max=left + width - 0.5,
                v_max=top + height - 0.5,
                slope=0.0,
                width_px=float(np.median(own.sum(axis=1))),
                pixels=pixels,
                foot="visible",
                cut=cut_sides(left, left + width - 1, top, top + height - 1, mask.shape),
                touches_sign=bool((signs[box] & own).any()),
                reason=reason,
            )
        )
    return sorted(found, key=lambda one: (one.u_foot, one.v_foot))


def _elongation(own: Bytes) -> float:
    """Longer over shorter axis of the ellipse that has a component's second moments."""
    place = np.argwhere(own).astype(np.float64)
    # A pixel is a square of side 1: it has a second moment of its own.
    spread = np.cov(place.T, bias=True) + np.eye(2) / 12.0
    least, most = np.linalg.eigvalsh(spread)
    return float(np.sqrt(most / least))
