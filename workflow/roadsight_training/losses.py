"""What training minimises, for classes and for relative inverse depth."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from roadsight.base.arrays import Floats32
from roadsight.poles.images.kinds import PixelClass

# Others have 1. Kept small: larger weights widen thin objects, and their borders matter.
CLASS_WEIGHTS = {
    PixelClass.ROAD: 1.5,
    PixelClass.MARKING: 2.0,
    PixelClass.POLE: 3.0,
    PixelClass.SIGN: 3.0,
    PixelClass.GUARDRAIL: 2.0,
    PixelClass.BUILDING: 1.5,
    PixelClass.SKY: 0.7,
    PixelClass.TREE: 0.8,
    PixelClass.VEGETATION: 0.8,
}
# Classes whose overlap counts beside each pixel (Dice): thin ones, the road, and cars, which boards
# of signs are taken for.
OVERLAP_CLASSES = (
    PixelClass.ROAD,
    PixelClass.MARKING,
    PixelClass.POLE,
    PixelClass.SIGN,
    PixelClass.WIRE,
    PixelClass.GUARDRAIL,
    PixelClass.VEHICLE,
)
# A sign of so many pixels or more counts by them, as all else does: 0.75 m across at 80 m in a view
# of 20 degrees, 25 m in one of 60.
_WHOLE_PX = 400.0
# By which the pixels of a small sign count more, so that one of 25 px counts as a fourth of one of
# 400 px and not as a sixteenth: a map asks whether a sign is seen, not how large.
_MOST_TIMES = 4.0
_LEAST_SPREAD = 1e-3  # Least divisor, for images of one depth.
_NEARNESS_FLOOR = 0.3  # Keeps the weight of the farthest pixels finite.
# Others have 1: poles have few pixels, and the road is what metres are fitted to.
_DEPTH_WEIGHTS = {PixelClass.POLE: 12.0, PixelClass.ROAD: 1.5, PixelClass.MARKING: 1.5}
_STEP_SHARE = 0.2  # Weight of the error's steps, which keep the edges of objects.


def classes_loss(logits: Tensor, classes: Tensor) -> Tensor:
    """Weighted cross-entropy plus 1 - Dice over the batch, for logits (n, 13, h, w).

    Pixels of small signs count more in the entropy, see `sign_weights`.
    """
    weights = torch.ones(logits.shape[1])
    for kind, weight in CLASS_WEIGHTS.items():
        weights[int(kind)] = weight
    shares = logits.float().log_softmax(dim=1)
    each = weights[classes] * torch.from_numpy(sign_weights(classes.numpy()))
    lost = functional.nll_loss(shares, classes, reduction="none")
    entropy = (each * lost).sum() / each.sum()
    kinds = torch.tensor([int(kind) for kind in OVERLAP_CLASSES])
    found = shares.index_select(1, kinds).exp()
    truth = (classes[:, None] == kinds[:, None, None]).float()
    both, either = (found * truth).sum(dim=(0, 2, 3)), (found + truth).sum(dim=(0, 2, 3))
    return entropy + 0.5 * (1.0 - (2.0 * both + 1.0) / (either + 1.0)).mean()


def sign_weights(classes: NDArray[np.integer]) -> Floats32:
    """Weight (n, h, w) of each pixel: 1, and more in signs of few pixels, by the root of them."""
    weights = np.ones(classes.shape, np.float32)
    for own, weight in zip(classes == PixelClass.SIGN, weights, strict=True):
        _, labels, stats, _ = cv2.connectedComponentsWithStats(own.astype(np.uint8), connectivity=8)
        times = np.sqrt(_WHOLE_PX / stats[:, cv2.CC_STAT_AREA]).clip(1.0, _MOST_TIMES)
        weight[own] = times[labels[own]]
    return weights


def normalised(values: Tensor) -> Tensor:
    """Values (n, h, w) less their median, over their mean distance from it, by image."""
    flat = values.flatten(1)
    centred = flat - flat.median(dim=1, keepdim=True).values
    spread = centred.abs().mean(dim=1, keepdim=True)
    return (centred / spread.clamp(min=_LEAST_SPREAD)).view_as(values)


def depth_loss(found: Tensor, inverse_depth: Tensor, classes: Tensor) -> Tensor:
    """Loss of relative inverse depth (n, h, w), the same for any scale and offset of the truth.

    Found and true values are normalised by image (Ranftl et al. 2022, section 5), so the network
    cannot and need not know metres. Errors count by the true nearness, so that far poles weigh as
    much as the road in front; poles, few as their pixels are, and the road count more. A tenth of
    the loss ties the network's own numbers to the normalised ones, which leaves its scale no room
    to drift.
    """
    found = found.float()
    truth, own = normalised(inverse_depth), normalised(found)
    nearness = truth - truth.flatten(1).min(dim=1).values[:, None, None]
    weights = 1.0 / (_NEARNESS_FLOOR + nearness)
    for kind, weight in _DEPTH_WEIGHTS.items():
        weights = weights * torch.where(classes == int(kind), weight, 1.0)
    weights = weights / weights.mean(dim=(1, 2), keepdim=True)
    error = own - truth
    plain = (weights * error.abs()).mean() + 0.1 * (weights * (found - truth).abs()).mean()
    # Mean change of the error between neighbours, at four sizes: keeps the edges of objects.
    lost = error.new_zeros(())
    for step in (1, 2, 4, 8):
        thinned = error[:, ::step, ::step]
        lost = lost + thinned.diff(dim=1).abs().mean() + thinned.diff(dim=2).abs().mean()
    return plain + _STEP_SHARE * (lost / 4.0)
