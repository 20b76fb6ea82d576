"""Train a U-Net that refines depth maps and write it as an ONNX file with its record.

Two shapes: ``light`` is ours; ``published`` is the paper's, trained by the paper's rules (70 % of
the pairs, mean squared error over all cells) and tested on 15 % of them.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import onnx
import torch
from torch import nn

from roadsight.base import SEED
from roadsight.base.errors import InputError
from roadsight.io.images.models import DepthNetwork
from roadsight.io.records.depth_maps import DepthPairs, digest, read_dataset
from roadsight.placement.depth.unet import MULTIPLE_CELLS, STEP_DEG
from roadsight.stages.command import Command
from roadsight_training.depth_network import DepthUnet, depth_loss
from roadsight_training.depth_patches import PATCH_CELLS, random_patches
from roadsight_training.evaluate_depth_network import pixel_errors
from roadsight_training.export import export_network
from roadsight_training.learning import Schedule, facts_of, learn
from roadsight_training.published_unet import (
    FILTERS,
    PublishedUnet,
    layers_of,
    regression_loss,
    split_pairs,
)
from roadsight_training.samples import update_record

log = logging.getLogger("train_depth_network")
_LOG_EVERY = 100  # Steps between two lines of the log.


def train(
    dataset: Sequence[DepthPairs],
    schedule: Schedule,
    build: Callable[[], nn.Module],
    watch: Callable[[int, float, nn.Module], None],
) -> nn.Module:
    """Network whose weights are the running mean over the last steps.

    Patches of step s depend on the seed and s only.

    Parameters
    ----------
    build : makes the untrained network, a `DepthUnet` or `PublishedUnet`.
    watch : called after each step with its number, its loss and the network so far.
    """
    torch.use_deterministic_algorithms(True)
    torch.manual_seed(schedule.seed)
    network = build().to(memory_format=torch.channels_last).train()

    def loss_of(rng: np.random.Generator) -> torch.Tensor:
        patches = random_patches(dataset, schedule.batch, rng)
        preliminary, refined, scale_m = (torch.from_numpy(part) for part in patches)
        output = network(preliminary.contiguous(memory_format=torch.channels_last))
        if isinstance(network, PublishedUnet):
            return regression_loss(output, refined)
        return depth_loss(output, refined, scale_m)

    return learn(network, schedule, loss_of, watch)


@dataclass(frozen=True)
class Training:
    """What a network is trained on, and how."""

    data: Annotated[Path, "folder that render_depth_dataset wrote"]
    out: Annotated[Path, "ONNX file; the record lies beside it"]
    truth: Annotated[str, "refined maps that are learnt"] = "exact"
    shape: Annotated[Literal["light", "published"], "ours, or the paper's 33 layers"] = "light"
    widths: Annotated[tuple[int, int, int], "light: channels at 1/2, 1/4, 1/8"] = (24, 40, 64)
    filters: Annotated[int, "published: filters at the first level"] = FILTERS
    steps: int = 5000
    batch: Annotated[int, "patches of a step"] = 32
    rate: Annotated[float, "highest learning rate"] = 3e-3
    seed: int = SEED
    threads: Annotated[int, "other numbers, other last digits"] = 1


def train_depth_network(given: Training) -> None:
    """Train, write the network and what was done into the record."""
    if given.steps < 1 or given.batch < 1:
        raise InputError("--steps and --batch must be 1 or more")
    torch.set_num_threads(given.threads)
    dataset = read_dataset(given.data, given.truth)
    parts: tuple[list[DepthPairs], ...] = (list(dataset.values()), [], [])
    if given.shape == "published":
        parts = split_pairs(parts[0], given.seed)
    schedule = Schedule(given.steps, given.batch, given.rate, given.seed)
    losses: list[float] = []

    def watch(step: int, loss: float, _: nn.Module) -> None:
        losses.append(loss)
        if (step + 1) % _LOG_EVERY == 0:
            log.info("step %d, loss %.4f", step + 1, np.mean(losses[-_LOG_EVERY:]))

    wall, cpu = time.perf_counter(), time.process_time()
    builds = {
        "light": partial(DepthUnet, given.widths),
        "published": partial(PublishedUnet, given.filters),
    }
    network = train(parts[0], schedule, builds[given.shape], watch)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    path = given.out
    facts = {"step_deg": f"{STEP_DEG:g}", "multiple_cells": str(MULTIPLE_CELLS)}
    difference = export_network(
        network, path, "refined", "depth", channels=1, facts={"kind": "depth_refinement"} | facts
    )
    entry = _entry(given, dataset, losses)
    entry |= facts_of(network, path, difference, wall, cpu)
    if isinstance(network, PublishedUnet):
        written = DepthNetwork(path)
        entry |= {
            "layers": layers_of(network),
            "filters": given.filters,
            "maps_of_parts": [sum(map(len, part)) for part in parts],
            "validation": pixel_errors(parts[1], written),
            "test": pixel_errors(parts[2], written),
        }
        log.info("test: %s", entry["test"])
    update_record(path.with_name("training_record.json"), path.name, entry)


def _entry(given: Training, dataset: dict[str, DepthPairs], losses: list[float]) -> dict[str, Any]:
    """What the record says about a training."""
    means = [float(part.mean()) for part in np.array_split(np.array(losses), 10) if len(part)]
    return {
        "seed": given.seed,
        "data": {
            "truth": given.truth,
            "scenes": list(dataset),
            "maps": sum(map(len, dataset.values())),
            "sha256": digest(dataset.values()),
        },
        **({"widths": list(given.widths)} if given.shape == "light" else {}),
        "steps": given.steps,
        "batch": given.batch,
        "patch_cells": PATCH_CELLS,
        "highest_learning_rate": given.rate,
        "threads": given.threads,
        "versions": {"torch": torch.__version__, "onnx": onnx.__version__, "numpy": np.__version__},
        "loss_by_tenth": [round(value, 4) for value in means],
    }


main = Command(train_depth_network)


if __name__ == "__main__":
    sys.exit(main())
