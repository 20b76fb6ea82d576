"""Train the project's own networks on rendered views and write them as ONNX files."""

from __future__ import annotations

import argparse
import copy
import logging
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import torch
from torch import Tensor, nn

from roadsight.base.errors import InputError
from roadsight.stages.command import run_stage
from roadsight.training.augment import Batch, Crops, random_batch
from roadsight.training.export import export_network
from roadsight.training.learning import Schedule, facts_of, learn
from roadsight.training.losses import classes_loss, depth_loss
from roadsight.training.networks import MULTIPLE_PX, RoadClasses, RoadDepth, seeded
from roadsight.training.record import read_entry, update_record
from roadsight.training.restart import start_from
from roadsight.training.samples import Sample, digest, read_samples

log = logging.getLogger("train_networks")

_LOG_EVERY = 50
"""Steps between two lines of the log."""


@dataclass(frozen=True)
class Task:
    """A network and how it is trained.

    Parameters
    ----------
    network : its class. loss : of its output for a batch. crops : what it sees.
    batch : how many of them at once. file, output : name of the ONNX file and of the output in it.
    """

    network: type[nn.Module]
    loss: Callable[[Tensor, Batch], Tensor]
    crops: Crops
    batch: int
    file: str
    output: str


def _loss_of_classes(output: Tensor, batch: Batch) -> Tensor:
    return classes_loss(output, torch.from_numpy(batch.classes))


def _loss_of_depth(output: Tensor, batch: Batch) -> Tensor:
    truth, classes = torch.from_numpy(batch.inverse_depth), torch.from_numpy(batch.classes)
    return depth_loss(output[:, 0], truth, classes)


TASKS = {
    "classes": Task(RoadClasses, _loss_of_classes, Crops(), 8, "road_classes.onnx", "logits"),
    "depth": Task(
        RoadDepth,
        _loss_of_depth,
        Crops(384, 576, (0.75, 1.25), 0.3),
        4,
        "road_depth.onnx",
        "inverse_depth",
    ),
}
"""Depth sees most of a view at once, because where the ground lies tells how far it is."""


def train(
    task: Task,
    samples: list[Sample],
    schedule: Schedule,
    watch: Callable[[int, float, nn.Module], None],
    start: str | None = None,
) -> nn.Module:
    """Network whose weights are the running mean over the last steps.

    Crops of step s depend on the seed and s only. The arithmetic of the convolutions is bfloat16,
    weights and losses are float32.

    Parameters
    ----------
    watch : called after each step with its number, its loss and the network so far.
    start : ONNX file whose weights to begin with; fresh ones if None.
    """
    torch.use_deterministic_algorithms(True)
    torch.utils.deterministic.fill_uninitialized_memory = False
    network = seeded(task.network, schedule.seed).to(memory_format=torch.channels_last)
    if start is not None:
        rng = np.random.default_rng([schedule.seed, schedule.steps])
        batch = random_batch(samples, schedule.batch, task.crops, rng)
        start_from(network, start, torch.from_numpy(batch.images))
    network.train()

    def loss_of(rng: np.random.Generator) -> Tensor:
        batch = random_batch(samples, schedule.batch, task.crops, rng)
        images = torch.from_numpy(batch.images).contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            output = network(images)
        return task.loss(output, batch)

    return learn(network, schedule, loss_of, watch)


def train_networks(arguments: argparse.Namespace) -> None:
    """Train one network, write it and what was done into the record."""
    if arguments.steps < 1:
        raise InputError("--steps must be 1 or more", found=arguments.steps)
    torch.set_num_threads(arguments.threads)
    task = _task(arguments)
    schedule = Schedule(arguments.steps, task.batch, arguments.rate, arguments.seed)
    path = Path(arguments.out) / task.file
    samples = [s for _, s in read_samples(arguments.data, arguments.first_seed, arguments.sites)]
    log.info("%d views", len(samples))
    losses: list[float] = []
    wall, cpu = time.perf_counter(), time.process_time()
    watch = _watch(arguments, task, path, losses)
    network = train(task, samples, schedule, watch, arguments.start_from)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    difference = export_network(network, path, task.output)
    entry = _entry(arguments, task, schedule, losses, samples)
    entry |= facts_of(network, path, difference, wall, cpu)
    update_record(path.with_name("training_record.json"), task.file, entry)


def _watch(
    arguments: argparse.Namespace, task: Task, path: Path, losses: list[float]
) -> Callable[[int, float, nn.Module], None]:
    """What happens after a step: its loss is kept, and now and then told or the network written."""

    def watch(step: int, loss: float, kept: nn.Module) -> None:
        losses.append(loss)
        if (step + 1) % _LOG_EVERY == 0:
            recent = np.mean(losses[-_LOG_EVERY:])
            log.info("%s: step %d, loss %.4f", arguments.network, step + 1, recent)
        if arguments.export_every and (step + 1) % arguments.export_every == 0:
            export_network(copy.deepcopy(kept), path, task.output)

    return watch


def _task(arguments: argparse.Namespace) -> Task:
    """The network's task, with another size and number of crops if they are given."""
    task = TASKS[arguments.network]
    height_px, width_px = arguments.crop_px or (task.crops.height_px, task.crops.width_px)
    if height_px % MULTIPLE_PX or width_px % MULTIPLE_PX or min(height_px, width_px) < 1:
        raise InputError(
            f"--crop-px must be multiples of {MULTIPLE_PX}", found=f"{height_px} {width_px}"
        )
    crops = replace(task.crops, height_px=height_px, width_px=width_px)
    return replace(task, crops=crops, batch=arguments.batch or task.batch)


def _entry(
    arguments: argparse.Namespace,
    task: Task,
    schedule: Schedule,
    losses: list[float],
    samples: list[Sample],
) -> dict[str, Any]:
    """What the record says about a training."""
    tenth = max(len(losses) // 10, 1)
    means = [float(np.mean(losses[i : i + tenth])) for i in range(0, len(losses), tenth)]
    first = {}
    if arguments.start_from:
        earlier = Path(arguments.start_from).with_name("training_record.json")
        first = {"first_training": read_entry(earlier, task.file)}
    return first | {
        "seed": schedule.seed,
        "data": {
            "first_seed": arguments.first_seed,
            "sites": arguments.sites,
            "views": len(samples),
            "sha256": digest(samples),
        },
        "steps": schedule.steps,
        "batch": schedule.batch,
        "passes_over_data": round(schedule.steps * schedule.batch / len(samples), 1),
        "crop_px": [task.crops.height_px, task.crops.width_px],
        "highest_learning_rate": schedule.rate,
        "threads": arguments.threads,
        "versions": {
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "numpy": np.__version__,
            "opencv": cv2.__version__,
        },
        "loss_by_tenth": [round(value, 4) for value in means],
    }


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", required=True, help="folder that render_dataset wrote")
    parser.add_argument("--out", required=True, help="folder of the ONNX files and the record")
    parser.add_argument("--network", choices=tuple(TASKS), required=True)
    parser.add_argument("--steps", type=int, default=1800)
    parser.add_argument("--rate", type=float, default=3e-3, help="highest learning rate")
    parser.add_argument(
        "--crop-px", type=int, nargs=2, metavar=("HEIGHT", "WIDTH"), help="instead of the task's"
    )
    parser.add_argument("--batch", type=int, help="crops of a step, instead of the task's")
    parser.add_argument("--start-from", help="ONNX file of this network to go on training from")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=1000, help="first site of the data")
    parser.add_argument("--sites", type=int, default=44)
    parser.add_argument("--threads", type=int, default=1, help="other numbers, other last digits")
    parser.add_argument("--export-every", type=int, default=0, help="steps; 0 is at the end only")
    return run_stage(parser, train_networks, argv)


if __name__ == "__main__":
    sys.exit(main())
