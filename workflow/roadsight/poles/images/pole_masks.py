"""Single poles and panels of signs in a mask of project classes (paper 2, section 3.1).

A pole is cleaned of its wires by a vertical opening, gets an axis by a robust line, and a foot at
the lower end of the axis. A panel has the middle of its pixels instead. More components than 255
are no difficulty: labels have 32 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats
from roadsight.base.sections.poles import PoleMasks
from roadsight.poles.images.kinds import KINDS, PixelClass
from roadsight.poles.images.views import scale_of

# Classes that hide a foot where they lie below it; plants may be grass, and are told apart
_HIDERS = (
    PixelClass.VEHICLE,
    PixelClass.TREE,
    PixelClass.GUARDRAIL,
    PixelClass.SIGN,
    PixelClass.BUILDING,
)
_LINE_ROUNDS = 10  # Rounds of reweighting for least absolute errors
# Pieces of one axis are joined over gaps up to this share of the longer one's height
_JOIN_SHARE = 0.5
# Height of the strip below a foot that tells what hides it; px of an image 1200 px high
_FOOT_PX = 12.0
# Classes for which the shipped network takes white panels. It takes green ones for road, which
# also ends behind posts: with it, strays outweigh what is gained.
_BOARDS = (
    PixelClass.OTHER,
    PixelClass.VEHICLE,
    PixelClass.MARKING,
    PixelClass.GUARDRAIL,
    PixelClass.SIGN,
)
_COMPACT = 0.45  # Share of its box that a board fills; half of it is what a diamond does
_ON_A_POST = 0.8  # Share of the rows below a board, as many as it has, in which its post is seen
_POST_SHARE = 0.35  # Share of what is below a board that its post takes at most
# Heights of a board by which its post may go on above it: utility poles go on above what hangs on
# them, such as transformers. One that is not seen in most of the rows just above the board, half
# as many as it has, begins higher up: a pole behind it.
_POST_ABOVE = 1.0
# Posts that part a panel are narrower than this, px of such an image: one of 7 cm is, from 9 m on,
# in a view of 20 degrees
_POST_PX = 40.0


@dataclass(frozen=True)
class Instance:
    """One object in an image; pixel centres are whole numbers.

    Parameters
    ----------
    kind : "pole", ... . u_foot, v_foot : lower end of its axis, of a panel its middle.
    u_min, v_min, u_max, v_max : box.
    slope : du / dv of the axis. width_px : median width. pixels : area. foot : "visible", "hidden",
    or "plants" (on grass, or behind a bush). cut : which of "left", "right", "top" and "bottom" of
    the frame cut it.
    touches_sign : whether a sign touches it. reason : why it is dropped, or "".
    """

    kind: str
    u_foot: float
    v_foot: float
    u_min: float
    v_min: float
    u_max: float
    v_max: float
    slope: float
    width_px: float
    pixels: int
    foot: str
    cut: frozenset[str]
    touches_sign: bool
    reason: str

    def axis_u(self, v_px: Floats) -> Floats:
        """Column of the axis at rows v (n,)."""
        return self.u_foot + self.slope * (np.asarray(v_px, np.float64) - self.v_foot)


def find_instances(
    mask: Bytes, kind: str = "pole", settings: PoleMasks | None = None
) -> list[Instance]:
    """Poles or signs in a mask (rows, columns), left to right.

    All are given that are large enough to measure; ``reason`` says which of them are no poles.
    """
    settings = settings or PoleMasks()
    scale = scale_of(mask.shape[0])
    shape = KINDS[kind].shape
    own: NDArray = np.isin(mask, [int(c) for c in KINDS[kind].classes]).view(np.uint8)
    if shape == "stem":
        length = max(round(settings.wire_px * scale), 3) | 1  # an even kernel shifts by a pixel
        own = cv2.morphologyEx(own, cv2.MORPH_OPEN, np.ones((length, 1), np.uint8))
    if shape == "panel":
        posts = (mask == PixelClass.POLE).view(np.uint8)
        own = _whole_panels(own | _boards(mask, posts, settings, scale), posts, scale)
    least_px = KINDS[kind].height_px or settings.min_height_px
    pieces = _pieces(own, max(least_px * scale / 4, 3.0))
    if shape == "stem":
        pieces = _joined(pieces)
    found = [_measured(piece, mask, kind, settings, scale) for piece in pieces]
    return sorted(found, key=lambda one: (one.u_foot, one.v_foot))


def _boards(mask: Bytes, posts: Bytes, settings: PoleMasks, scale: float) -> Bytes:
    """What stands on a post and is of no class that could: panels that a network does not know.

    It is compact, at most three times as wide as high, and only its post is below it, which ends
    at it or not far above.
    """
    board = _whole_panels(np.isin(mask, _BOARDS).view(np.uint8), posts, scale)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        board, connectivity=4, ltype=cv2.CV_32S
    )
    found = np.zeros_like(board)
    least_px = (KINDS["sign"].height_px or settings.min_height_px) * scale
    for number in range(1, count):
        left, top, width, height, pixels = stats[number]
        if height < least_px or width < 0.4 * height or width > 3.0 * height:
            continue
        if pixels < _COMPACT * width * height:
            continue
        below = posts[top + height : top + 2 * height, left : left + width]
        middle = slice(int(0.3 * width), int(np.ceil(0.7 * width)))
        if len(below) < height or below[:, middle].any(axis=1).mean() < _ON_A_POST:
            continue
        above = posts[max(top - 2 * height, 0) : top, left : left + width][:, middle].max(axis=1)
        joined = len(above) and above[-(height // 2) :].mean() >= _ON_A_POST
        if joined and above.sum() > _POST_ABOVE * height:
            continue
        if below.mean() < _POST_SHARE:
            found[labels == number] = 1
    return found


def _whole_panels(own: Bytes, posts: Bytes, scale: float) -> Bytes:
    """Panels with the post that parts what is seen of them from behind."""
    width = max(round(_POST_PX * scale), 3) | 1
    closed = cv2.morphologyEx(own, cv2.MORPH_CLOSE, np.ones((1, width), np.uint8))
    return np.asarray((own > 0) | ((closed > 0) & (posts > 0)), np.uint8)


@dataclass
class _Piece:
    """Rows of one component: row v, mean column and width of each, ascending rows."""

    v: Floats
    u: Floats
    width: Floats
    u_min: int
    u_max: int

    @cached_property
    def axis(self) -> tuple[float, float]:
        """Column at row 0 and slope du / dv, by least absolute errors; arms count less."""
        middle = np.median(self.width)
        base = 1.0 / np.maximum(self.width / middle, 1.0) ** 2
        v0 = self.v.mean()
        basis = np.column_stack([np.ones(len(self.v)), self.v - v0])
        weights, solution = base, np.array([np.median(self.u), 0.0])
        for _ in range(_LINE_ROUNDS if len(self.v) > 2 else 0):
            root = np.sqrt(weights)
            solution = np.linalg.lstsq(basis * root[:, None], self.u * root, rcond=None)[0]
            weights = base / np.maximum(np.abs(self.u - basis @ solution), 0.25)
        return float(solution[0] - solution[1] * v0), float(solution[1])

    @cached_property
    def middle_width(self) -> float:
        return float(np.median(self.width))

    @property
    def height(self) -> float:
        return float(self.v[-1] - self.v[0] + 1)


def _pieces(own: Bytes, least_height_px: float) -> list[_Piece]:
    """Components that are not too low, as rows."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        own, connectivity=8, ltype=cv2.CV_32S
    )
    pieces = []
    for number in range(1, count):
        left, top, width, height, _ = stats[number]
        if height < least_height_px:
            continue
        inside = labels[top : top + height, left : left + width] == number
        widths = inside.sum(axis=1)
        sums = inside @ np.arange(left, left + width, dtype=np.float64)
        pieces.append(
            _Piece(
                np.arange(top, top + height, dtype=np.float64),
                sums / widths,
                widths.astype(np.float64),
                int(left),
                int(left + width - 1),
            )
        )
    return pieces


def _joined(pieces: list[_Piece]) -> list[_Piece]:
    """Pieces of one axis as one: a sign, a wire or a leaf cuts a pole in two."""
    joined = sorted(pieces, key=lambda piece: (piece.v[0], piece.u_min))
    merged = True
    while merged:
        merged = False
        for i, upper in enumerate(joined):
            j = _continuation(upper, joined)
            if j is not None:
                lower = joined[j]
                joined[i] = _Piece(
                    np.concatenate([upper.v, lower.v]),
                    np.concatenate([upper.u, lower.u]),
                    np.concatenate([upper.width, lower.width]),
                    min(upper.u_min, lower.u_min),
                    max(upper.u_max, lower.u_max),
                )
                del joined[j]
                merged = True
                break
    return joined


def _continuation(upper: _Piece, pieces: list[_Piece]) -> int | None:
    """Position of the nearest piece below that lies on the axis of ``upper``."""
    best, best_gap = None, np.inf
    for j, lower in enumerate(pieces):
        gap = lower.v[0] - upper.v[-1] - 1
        if gap < 0 or gap >= best_gap:
            continue
        if gap > _JOIN_SHARE * max(upper.height, lower.height):
            continue
        width = max(upper.middle_width, lower.middle_width)
        thinner = min(upper.middle_width, lower.middle_width)
        # The longer piece has the surer axis: it must meet the other one's near end.
        upper_longer = upper.height >= lower.height
        u0, slope = (upper if upper_longer else lower).axis
        u, v = (lower.u[0], lower.v[0]) if upper_longer else (upper.u[-1], upper.v[-1])
        if abs(u0 + slope * v - u) <= 0.75 * width and width <= 2.5 * thinner + 1:
            best, best_gap = j, gap
    return best


def _measured(piece: _Piece, mask: Bytes, kind: str, settings: PoleMasks, scale: float) -> Instance:
    """A pole with its foot, or a panel, which stands above the ground: with its pixels' middle."""
    width = piece.middle_width
    cut = cut_sides(piece.u_min, piece.u_max, piece.v[0], piece.v[-1], mask.shape)
    least_px = (KINDS[kind].height_px or settings.min_height_px) * scale
    small = width < settings.min_width_px * scale or piece.height < least_px
    reason, foot, slope = "too small" if small else "", "hidden", 0.0
    if KINDS[kind].shape == "panel":
        u_foot, v_foot = (float(np.average(at, weights=piece.width)) for at in (piece.u, piece.v))
        reason = reason or ("cut by the frame" if cut else "")
    else:
        u0, slope = piece.axis
        # Last row that still belongs to the axis, so that a stray blob below is not the foot.
        on_axis = np.abs(piece.u - u0 - slope * piece.v) <= max(width, 1.5)
        good = np.flatnonzero(on_axis & (piece.width >= 0.5 * width))
        v_foot = float(piece.v[good[-1]] if len(good) else piece.v[-1]) + 0.5
        u_foot = u0 + slope * v_foot
        if "bottom" not in cut:
            # What the strip just below says, by the majority of its pixels.
            half, top = max(width / 2, 1.0), int(np.ceil(v_foot))
            left, deep_px = max(int(u_foot - half), 0), max(round(_FOOT_PX * scale), 2)
            below = mask[top : top + deep_px, left : max(int(u_foot + half), left) + 1]
            if np.count_nonzero(np.isin(below, [int(c) for c in _HIDERS])) < 0.5 * below.size:
                foot = "plants" if np.mean(below == PixelClass.VEGETATION) >= 0.5 else "visible"
        if not reason and piece.height * np.hypot(1.0, slope) < settings.min_aspect * width:
            reason = "not slender"
    return Instance(
        kind,
        u_foot,
        v_foot,
        u_min=piece.u_min - 0.5,
        v_min=piece.v[0] - 0.5,
        u_max=piece.u_max + 0.5,
        v_max=piece.v[-1] + 0.5,
        slope=slope,
        width_px=width,
        pixels=int(piece.width.sum()),
        foot=foot,
        cut=cut,
        touches_sign=KINDS[kind].shape == "panel" or _touches_sign(piece, mask),
        reason=reason,
    )


def _touches_sign(piece: _Piece, mask: Bytes) -> bool:
    """Whether a few rows have pixels of a sign on the axis or directly beside the piece."""
    rows = np.arange(max(int(piece.v[0]) - 2, 0), int(piece.v[-1]) + 1)
    u0, slope = piece.axis
    centre = np.round(u0 + slope * rows).astype(int)
    half = int(np.ceil(piece.middle_width / 2)) + 1
    columns = np.clip(centre[:, None] + [-half, 0, half], 0, mask.shape[1] - 1)
    return bool(np.count_nonzero((mask[rows[:, None], columns] == PixelClass.SIGN).any(axis=1)) > 2)


def cut_sides(
    left: float, right: float, top: float, bottom: float, shape: tuple[int, ...]
) -> frozenset[str]:
    """Sides of a frame (rows, columns) that cut a box of whole pixels."""
    sides = {
        "left": left <= 0,
        "right": right >= shape[1] - 1,
        "top": top <= 0,
        "bottom": bottom >= shape[0] - 1,
    }
    return frozenset(name for name, touches in sides.items() if touches)


# Poles in a mask by the pole study's rules (section 3.1; numbers of the authors' code).
# Numbers in pixels are of an image 1200 px high and are scaled with the height. The authors'
# labels are stored in 8 bits, so that the 257th component is the first again; here they are not.

_WIDER_PX, _TALLER_PX = 10.0, 20.0  # A pole's box is wider and taller than this
# Height over width from which a component is a pole as it is; below it, what is as long for its
# width across its own axes is one after its wires are removed
_ASPECT = 10.0
_KERNEL_PX = 10  # Side of the square by which wires are removed


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
