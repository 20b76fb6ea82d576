"""The placement paper's U-Net of 33 layers (section 2.4, Fig. 10b), as far as its text says.

The figure's contents are lost. The layers below are what the paper's software makes of a U-Net of
two levels (MATLAB's ``unetLayers``, EncoderDepth 2: 34 layers) once the paper's regression layer
takes the place of softmax and pixel classification:

    input                                                                     1
    level 1: convolution, rectifier, convolution, rectifier, pooling          5
    level 2: the same, with dropout before the pooling                        6
    bridge: convolution, rectifier, convolution, rectifier, dropout           5
    two levels up: up-convolution, rectifier, concatenation, convolution,
        rectifier, convolution, rectifier                                    14
    convolution of 1 x 1, regression                                          2

No other depth gives 33. Guessed: 16 filters at the first level (the paper says "lightweight" and
"empirically"), filters of 3 x 3, dropout of one half (MATLAB's), no batch normalisation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from roadsight.base.errors import InputError
from roadsight.io.records.depth_maps import DepthPairs

FILTERS = 16  # At the first level; doubled by each of the two poolings.
# Of the pairs to train on, to validate by and to test by: 423,353, 90,718 and 90,718 of the paper's
# 604,789.
SHARES = (0.70, 0.15, 0.15)


class PublishedUnet(nn.Module):
    """Refined depth (n, 1, h, w) of normalised maps (n, 1, h, w); 0 is no return.

    Parameters
    ----------
    filters : at the first level.
    """

    def __init__(self, filters: int = FILTERS) -> None:
        super().__init__()
        one, two, four = filters, 2 * filters, 4 * filters
        self.first = _twice(1, one)
        self.second = nn.Sequential(_twice(one, two), nn.Dropout(0.5))
        self.pool = nn.MaxPool2d(2)
        self.bridge = nn.Sequential(_twice(two, four), nn.Dropout(0.5))
        self.up_second = nn.Sequential(nn.ConvTranspose2d(four, two, 2, 2), nn.ReLU())
        self.mix_second = _twice(2 * two, two)
        self.up_first = nn.Sequential(nn.ConvTranspose2d(two, one, 2, 2), nn.ReLU())
        self.mix_first = _twice(2 * one, one)
        self.last = nn.Conv2d(one, 1, 1)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
                nn.init.kaiming_normal_(layer.weight)
                nn.init.zeros_(layer.bias)

    def forward(self, depth: Tensor) -> Tensor:
        """Both sides of the maps are multiples of 4 cells."""
        first = self.first(depth)
        second = self.second(self.pool(first))
        bridge = self.bridge(self.pool(second))
        second = self.mix_second(torch.cat([self.up_second(bridge), second], dim=1))
        return self.last(self.mix_first(torch.cat([self.up_first(second), first], dim=1)))


def _twice(inputs: int, outputs: int) -> nn.Sequential:
    """Two convolutions of 3 x 3, each with its rectifier."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.ReLU(),
    )


def layers_of(network: PublishedUnet) -> int:
    """Layers as the paper's software counts them: input, concatenations and regression too."""
    kinds = (nn.Conv2d, nn.ConvTranspose2d, nn.ReLU, nn.Dropout)
    poolings = concatenations = 2
    return (
        1 + sum(isinstance(one, kinds) for one in network.modules()) + poolings + concatenations + 1
    )


def regression_loss(output: Tensor, refined: Tensor) -> Tensor:
    """Half the mean squared error over all cells, those without return (0) among them."""
    return 0.5 * (output.float() - refined).square().mean()


def split_pairs(
    dataset: Sequence[DepthPairs], seed: int, shares: tuple[float, float, float] = SHARES
) -> tuple[list[DepthPairs], list[DepthPairs], list[DepthPairs]]:
    """Pairs to train on, to validate by and to test by, drawn at random from all scenes.

    As in the paper, pairs of one scene are in all three parts; pairs of other scenes are harder.

    Raises
    ------
    InputError : there are so few pairs that a part has none.
    """
    where = [(scene, pair) for scene, pairs in enumerate(dataset) for pair in range(len(pairs))]
    order = np.random.default_rng([seed, 0]).permutation(len(where))
    ends = np.rint(np.cumsum(shares) * len(where)).astype(int)
    if not np.diff([0, *ends]).all():
        raise InputError(
            "are too few to train on, to validate by and to test by", found=f"{len(where)} pairs"
        )
    parts: list[list[DepthPairs]] = []
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        chosen: dict[int, list[int]] = {}
        for scene, pair in sorted(where[k] for k in order[start:end]):
            chosen.setdefault(scene, []).append(pair)
        parts.append(
            [
                DepthPairs(dataset[scene].preliminary[rows], dataset[scene].refined[rows])
                for scene, rows in chosen.items()
            ]
        )
    return parts[0], parts[1], parts[2]
