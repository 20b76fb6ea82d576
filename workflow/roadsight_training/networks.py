"""The project's own small networks: classes of pixels and relative inverse depth.

Both are encoders of plain convolutions down to a sixteenth of the image, with dilated convolutions
and the mean of the whole image for context, and decoders that add what each size has seen.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

CLASSES = 13  # Number of `PixelClass`, which the network's file fixes.
MULTIPLE_PX = 16  # Both sides of the input are multiples of this.


class Convolution(nn.Sequential):
    """Convolution of 3 x 3, batch normalisation and rectifier; exported as one convolution."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class _Residual(nn.Module):
    """Convolution whose output is added to its input."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.convolution = Convolution(channels, channels, dilation=dilation)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.convolution(x)


class _Context(nn.Module):
    """Adds what the mean over the whole image tells."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.inner = nn.Conv2d(channels, channels, 1)
        self.outer = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        mean = x.mean(dim=(2, 3), keepdim=True)
        return x + self.outer(functional.relu(self.inner(mean)))


class Up(nn.Module):
    """Doubles the coarse features' size, adds the fine ones and mixes them."""

    def __init__(self, coarse: int, fine: int, mode: Literal["nearest", "bilinear"]) -> None:
        super().__init__()
        self.mode = mode
        self.fewer = nn.Conv2d(coarse, fine, 1)
        self.mix = Convolution(fine, fine)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """Features of the size of the fine ones."""
        corners = False if self.mode == "bilinear" else None
        doubled = functional.interpolate(
            self.fewer(coarse), scale_factor=2.0, mode=self.mode, align_corners=corners
        )
        return self.mix(doubled + fine)


class _Trunk(nn.Module):
    """Features of (n, inputs, h, w) that draw on all four sizes."""

    def __init__(
        self, inputs: int, widths: tuple[int, int, int, int], dilations: tuple[tuple[int, ...], ...]
    ) -> None:
        super().__init__()
        self.down = nn.ModuleList()
        for finer, outputs, steps in zip((inputs, *widths), widths, dilations, strict=False):
            # Halve the size, then residual convolutions.
            residuals = [_Residual(outputs, dilation) for dilation in steps]
            self.down.append(nn.Sequential(Convolution(finer, outputs, stride=2), *residuals))
        self.context = _Context(widths[3])
        self.up = nn.ModuleList(Up(widths[i + 1], widths[i], "bilinear") for i in (2, 1, 0))

    def features(self, x: Tensor, ups: int) -> Tensor:
        """After the first ``ups`` doublings: at 1/16 of the image's size times 2 ** ups."""
        seen = []
        for stage in self.down:
            x = stage(x)
            seen.append(x)
        x = self.context(x)
        for i in range(ups):
            x = self.up[i](x, seen[2 - i])
        return x


class RoadClasses(_Trunk):
    """Class logits (n, 13, h, w) of RGB images (n, 3, h, w) in 0 to 1."""

    def __init__(self) -> None:
        super().__init__(3, (24, 40, 64, 96), ((1,), (1, 1), (1, 2), (2, 4)))
        self.head = nn.Conv2d(24, 4 * CLASSES, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Logits of images whose sides are multiples of 16 px."""
        return functional.pixel_shuffle(self.head(self.features(image - 0.5, 3)), 2)


class RoadDepth(_Trunk):
    """Relative inverse depth (n, 1, h, w), larger = nearer, of RGB images (n, 3, h, w).

    It also sees how far down a pixel lies, as a share of the image's height: cameras of one kind
    look ahead, so that this tells most about the ground.
    """

    def __init__(self) -> None:
        super().__init__(4, (16, 32, 64, 96), ((), (1,), (1, 2), (1, 2, 4)))
        del self.up[2]
        self.head = nn.Conv2d(32, 1, 3, padding=1)

    def forward(self, image: Tensor) -> Tensor:
        """Inverse depth of images whose sides are multiples of 16 px."""
        rows = torch.ones_like(image[:, :1]).cumsum(dim=2)
        height = rows / rows[:, :, -1:] - 0.5
        quarter = self.head(self.features(torch.cat([image - 0.5, height], dim=1), 2))
        return functional.interpolate(
            quarter, scale_factor=4.0, mode="bilinear", align_corners=False
        )


def seeded(kind: type[nn.Module], seed: int) -> nn.Module:
    """Network with fresh weights that depend on the seed only."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return kind()
