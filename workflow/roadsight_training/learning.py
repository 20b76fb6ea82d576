"""How all networks of this project learn: AdamW, a schedule, a running mean of the weights."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from roadsight.base import SEED
from roadsight.io.records.sources import sha256

_WARM_UP = 0.05  # Share of the steps in which the learning rate rises.
_KEEP = 0.998  # Weight of the past in the running mean of the weights: some 500 steps.


@dataclass(frozen=True)
class Schedule:
    """How long and how fast.

    Parameters
    ----------
    steps : batches. batch : samples of a batch. rate : highest learning rate. seed : of everything.
    """

    steps: int
    batch: int
    rate: float = 3e-3
    seed: int = SEED

    def rate_at(self, step: int) -> float:
        """Learning rate: a short rise, then a half cosine down to a hundredth."""
        rise = max(_WARM_UP * self.steps, 1.0)
        if step < rise:
            return self.rate * (step + 1) / rise
        share = (step - rise) / max(self.steps - rise, 1.0)
        return self.rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))


def learn(
    network: nn.Module,
    schedule: Schedule,
    loss_of: Callable[[np.random.Generator], torch.Tensor],
    watch: Callable[[int, float, nn.Module], None],
) -> nn.Module:
    """Network whose weights are the running mean over the last steps.

    Parameters
    ----------
    loss_of : loss of ``network`` on a batch that the generator draws; the generator of step s
        depends on the seed and s only.
    watch : called after each step with its number, its loss and the network so far.
    """
    kept = copy.deepcopy(network).eval()
    optimiser = torch.optim.AdamW(network.parameters(), lr=schedule.rate, weight_decay=1e-3)
    for step in range(schedule.steps):
        loss = loss_of(np.random.default_rng([schedule.seed, step]))
        for group in optimiser.param_groups:
            group["lr"] = schedule.rate_at(step)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        # The running mean moves towards the network; counters are copied.
        share, new = min(_KEEP, (step + 1.0) / (step + 10.0)), network.state_dict()
        with torch.no_grad():
            for name, value in kept.state_dict().items():
                if value.dtype.is_floating_point:
                    value.lerp_(new[name], 1.0 - share)
                else:
                    value.copy_(new[name])
        watch(step, float(loss.detach()), kept)
    return kept


def facts_of(
    network: nn.Module, path: Path, difference: float, wall_s: float, cpu_s: float
) -> dict[str, Any]:
    """What the record says of every network: its cost, its file, and how exactly it was exported.

    Parameters
    ----------
    path : the ONNX file. difference : largest one between its outputs and the network's.
    """
    return {
        "wall_s": round(wall_s, 1),
        "cpu_s": round(cpu_s, 1),
        "sha256": sha256(path),
        "bytes": path.stat().st_size,
        "largest_difference_onnx_torch": difference,
        "parameters": sum(p.numel() for p in network.parameters()),
    }
