"""A light U-Net that refines preliminary depth maps (paper 1, Fig. 10b).

The first level works on 2 x 2 cells at once, so that nothing is convolved at full size. The last
layer chooses, cell by cell, among the ranges that lie around it, and corrects the choice a little:
a plain regression layer mixes the ranges of a surface and of what lies behind it.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from roadsight_training.networks import Convolution, Up

_FILL_LEVELS = (1, 2, 3)  # Halvings of the map: blocks of 2, 4 and 8 cells.
# Ranges that a cell chooses among: its own, and least and mean of 3 x 3 cells and of each block.
_CANDIDATES = 3 + 2 * len(_FILL_LEVELS)
# Means over fewer returns a cell are none: bilinear enlarging leaves traces of them around.
_LEAST_COUNT = 1e-3
_LIMIT = 15.0  # Scores are cut here before their exponential, which single precision bears.
_LEAST_WEIGHT = 1e-7  # Divisor where no range lies around: less than the least weight, exp(-15).


class DepthUnet(nn.Module):
    """Refined depth and the score of a return, (n, 2, h, w), of normalised maps (n, 1, h, w).

    Parameters
    ----------
    widths : channels at a half, a quarter and an eighth of the map's size.
    """

    def __init__(self, widths: tuple[int, int, int] = (24, 40, 64)) -> None:
        super().__init__()
        half, quarter, eighth = widths
        self.stem = nn.Sequential(Convolution(8, half), Convolution(half, half))
        self.down = nn.Sequential(Convolution(half, quarter, 2), Convolution(quarter, quarter))
        self.deep = nn.Sequential(
            Convolution(quarter, eighth, 2),
            Convolution(eighth, eighth),
            Convolution(eighth, eighth, dilation=2),
        )
        self.up = nn.ModuleList([Up(eighth, quarter, "nearest"), Up(quarter, half, "nearest")])
        self.head = nn.Conv2d(half, 4 * (_CANDIDATES + 2), 1)

    def forward(self, depth: Tensor) -> Tensor:
        """Both sides of the map are multiples of 8 cells; 0 is no return."""
        returns = (depth > 0).to(depth.dtype)
        half = self.stem(functional.pixel_unshuffle(torch.cat([depth, returns], dim=1), 2))
        quarter = self.down(half)
        mixed = self.up[1](self.up[0](self.deep(quarter), quarter), half)
        scores = functional.pixel_shuffle(self.head(mixed), 2)
        around = candidates(depth, returns)
        weight = scores[:, :_CANDIDATES].clamp(-_LIMIT, _LIMIT).exp() * (around > 0)
        total = weight.sum(dim=1, keepdim=True).clamp(min=_LEAST_WEIGHT)
        chosen = (weight * around).sum(dim=1, keepdim=True) / total
        refined = chosen * (1.0 + 0.1 * scores[:, _CANDIDATES : _CANDIDATES + 1])
        return torch.cat([refined, scores[:, _CANDIDATES + 1 :]], dim=1)


def candidates(depth: Tensor, returns: Tensor) -> Tensor:
    """What lies around each cell (n, k, h, w), 0 where nothing does.

    Its own range; least and mean range of 3 x 3 cells; and of blocks of 2, 4 and 8 cells, means
    blended over neighbouring blocks.
    """
    far = 2.0 * (1.0 - returns) + depth
    least = -functional.max_pool2d(-far, 3, 1, 1)
    nearby = (functional.avg_pool2d(x, 3, 1, 1) for x in (depth, returns))
    found = [depth, _some(least), _mean(*nearby)]
    total, count = depth, returns
    for level in _FILL_LEVELS:
        far = -functional.max_pool2d(-far, 2)
        total, count = functional.avg_pool2d(total, 2), functional.avg_pool2d(count, 2)
        scale = float(2**level)
        found.append(functional.interpolate(_some(far), scale_factor=scale, mode="nearest"))
        blended = (
            functional.interpolate(x, scale_factor=scale, mode="bilinear", align_corners=False)
            for x in (total, count)
        )
        found.append(_mean(*blended))
    return torch.cat(found, dim=1)


def _some(far: Tensor) -> Tensor:
    """Least range, 0 where there was none."""
    return torch.where(far < 2.0, far, torch.zeros_like(far))


def _mean(total: Tensor, count: Tensor) -> Tensor:
    """Mean range, 0 where there is (almost) none."""
    some = count > _LEAST_COUNT
    return torch.where(some, total / count.clamp(min=_LEAST_COUNT), torch.zeros_like(total))


def depth_loss(output: Tensor, truth: Tensor, scale_m: Tensor) -> Tensor:
    """Loss of refined depth and returns (n, 2, h, w) against truth (n, 1, h, w), normalised.

    A range that is wrong costs little more when it is very wrong, as in what is judged (beams off
    by 0.5 m). Returns are told by their cross-entropy.

    Parameters
    ----------
    scale_m : (n, 1, 1, 1) metres of the normalised 1.
    """
    there = (truth > 0).float()
    error_m = (output[:, :1].float() - truth).abs() * scale_m
    ranges = (there * torch.log1p(error_m / 0.25)).sum() / there.sum().clamp(min=1.0)
    returns = functional.binary_cross_entropy_with_logits(output[:, 1:].float(), there)
    return ranges + 2.0 * returns
