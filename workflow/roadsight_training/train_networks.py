"""Train the project's own networks on rendered views and write them as ONNX files."""

from __future__ import annotations

import copy
import logging
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import onnx
import torch
from torch import Tensor, nn

from roadsight.base import SEED
from roadsight.base.errors import InputError
from roadsight.poles.images.kinds import PixelClass
from roadsight.stages.command import Command
from roadsight_training.augment import Batch, Crops, random_batch
from roadsight_training.export import export_network, start_from
from roadsight_training.learning import Schedule, facts_of, learn
from roadsight_training.losses import classes_loss, depth_loss
from roadsight_training.networks import MULTIPLE_PX, RoadClasses, RoadDepth, seeded
from roadsight_training.samples import Sample, digest, read_entry, read_samples, update_record

log = logging.getLogger("train_networks")
_LOG_EVERY = 50  # Steps between two lines of the log.


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


# Where crops for the classes are placed.
_RARE = (
    PixelClass.POLE,
    PixelClass.MARKING,
    PixelClass.SIGN,
    PixelClass.SIGN,
    PixelClass.GUARDRAIL,
    PixelClass.GUARDRAIL,
    PixelClass.BUILDING,
    PixelClass.VEHICLE,
)
# Depth sees most of a view at once, because where the ground lies tells how far it is.
TASKS = {
    "classes": Task(
        RoadClasses, _loss_of_classes, Crops(wanted=_RARE), 8, "road_classes.onnx", "logits"
    ),
    "depth": Task(
        RoadDepth,
        _loss_of_depth,
        Crops(384, 576, (0.75, 1.25), 0.3),
        4,
        "road_depth.onnx",
        "inverse_depth",
    ),
}


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


@dataclass(frozen=True)
class Training:
    """What a network is trained on, and how."""

    data: Annotated[Path, "folder that render_dataset wrote"]
    out: Annotated[Path, "folder of the ONNX files and the record"]
    network: Literal["classes", "depth"]
    steps: int = 1800
    rate: Annotated[float, "highest learning rate"] = 3e-3
    crop_px: Annotated[tuple[int, int] | None, "height and width, not the task's"] = None
    batch: Annotated[int | None, "crops of a step, instead of the task's"] = None
    panels: Annotated[float, "signs drawn into a crop, in the mean"] = 0.0
    start_from: Annotated[str | None, "ONNX file of this network to go on training from"] = None
    seed: int = SEED
    first_seed: Annotated[int, "first site of the data"] = 1000
    sites: int = 44
    threads: Annotated[int, "other numbers, other last digits"] = 1
    export_every: Annotated[int, "steps; 0 is at the end only"] = 0


def train_networks(given: Training) -> None:
    """Train one network, write it and what was done into the record."""
    if given.steps < 1:
        raise InputError("--steps must be 1 or more", found=given.steps)
    torch.set_num_threads(given.threads)
    task = TASKS[given.network]
    height_px, width_px = given.crop_px or (task.crops.height_px, task.crops.width_px)
    if height_px % MULTIPLE_PX or width_px % MULTIPLE_PX or min(height_px, width_px) < 1:
        raise InputError(
            f"--crop-px must be multiples of {MULTIPLE_PX}", found=f"{height_px} {width_px}"
        )
    crops = replace(task.crops, height_px=height_px, width_px=width_px, panels=given.panels)
    task = replace(task, crops=crops, batch=given.batch or task.batch)
    schedule = Schedule(given.steps, task.batch, given.rate, given.seed)
    path = given.out / task.file
    samples = [s for _, s in read_samples(given.data, given.first_seed, given.sites)]
    log.info("%d views", len(samples))
    losses: list[float] = []
    wall, cpu = time.perf_counter(), time.process_time()
    watch = _watch(given, task, path, losses)
    network = train(task, samples, schedule, watch, given.start_from)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    difference = export_network(network, path, task.output)
    entry = _entry(given, task, schedule, losses, samples)
    entry |= facts_of(network, path, difference, wall, cpu)
    update_record(path.with_name("training_record.json"), task.file, entry)


def _watch(
    given: Training, task: Task, path: Path, losses: list[float]
) -> Callable[[int, float, nn.Module], None]:
    """What happens after a step: its loss is kept, and now and then told or the network written."""

    def watch(step: int, loss: float, kept: nn.Module) -> None:
        losses.append(loss)
        if (step + 1) % _LOG_EVERY == 0:
            recent = np.mean(losses[-_LOG_EVERY:])
            log.info("%s: step %d, loss %.4f", given.network, step + 1, recent)
        if given.export_every and (step + 1) % given.export_every == 0:
            export_network(copy.deepcopy(kept), path, task.output)

    return watch


def _entry(
    given: Training, task: Task, schedule: Schedule, losses: list[float], samples: list[Sample]
) -> dict[str, Any]:
    """What the record says about a training."""
    tenth = max(len(losses) // 10, 1)
    means = [float(np.mean(losses[i : i + tenth])) for i in range(0, len(losses), tenth)]
    first = {}
    if given.start_from:
        earlier = Path(given.start_from).with_name("training_record.json")
        first = {"first_training": read_entry(earlier, task.file)}
    return first | {
        "seed": schedule.seed,
        "data": {
            "first_seed": given.first_seed,
            "sites": given.sites,
            "views": len(samples),
            "sha256": digest(samples),
        },
        "steps": schedule.steps,
        "batch": schedule.batch,
        "passes_over_data": round(schedule.steps * schedule.batch / len(samples), 1),
        "crop_px": [task.crops.height_px, task.crops.width_px],
        "panels_per_crop": task.crops.panels,
        "highest_learning_rate": schedule.rate,
        "threads": given.threads,
        "versions": {
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "numpy": np.__version__,
            "opencv": cv2.__version__,
        },
        "loss_by_tenth": [round(value, 4) for value in means],
    }


main = Command(train_networks)


if __name__ == "__main__":
    sys.exit(main())
