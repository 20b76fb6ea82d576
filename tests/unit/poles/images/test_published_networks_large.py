"""Large published networks: exported by the page's commands and run by the stages at their sizes.

Weights are random: what is tested is the commands, the preprocessing, shapes, labels and cost.
"""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from roadsight.base.section import validated
from roadsight.base.texts import read_yaml
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.images.models import open_model
from roadsight.io.records.tables import write_table
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.networks import (
    FULL_SCALE,
    SILENT,
    Manifest,
    class_mask,
    inverse_depth,
    packed_depth,
    tensor_of,
)
from tests.conftest import PROJECT

pytestmark = pytest.mark.full

PAGE = PROJECT / "docs/poles/models.md"
MANIFESTS = PROJECT / "resources/manifests"
PARAMETERS = {
    "segformer_cityscapes": 84.6e6,
    "depth_anything": 24.8e6,
    "oneformer_mapillary": 219e6,
}
"""Weights of SegFormer B5, Depth Anything Small and OneFormer Swin-L, as in their papers."""
AT_MOST_MIB = {"segformer_cityscapes": 7000, "depth_anything": 1200, "oneformer_mapillary": 5000}
"""Of a stage; the page states what was measured."""
AT_MOST_S = 1200
"""Of a stage, on a machine busy with other work; the page states what was measured."""

Export = Callable[[str], tuple[Any, Path]]


def block(name: str) -> str:
    """The page's command that writes a network."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (found,) = (code for code in blocks if f'"{name}.onnx"' in code)
    return found


def published(name: str):
    """Network of the published size with random weights, from its configuration alone."""
    import torch
    import transformers

    torch.manual_seed(1)
    if name == "segformer_cityscapes":
        config = transformers.SegformerConfig(
            num_labels=19,
            depths=[3, 6, 40, 3],
            hidden_sizes=[64, 128, 320, 512],
            decoder_hidden_size=768,
        )
        return transformers.SegformerForSemanticSegmentation(config)
    if name == "depth_anything":
        return transformers.DepthAnythingForDepthEstimation(transformers.DepthAnythingConfig())
    swin_large = transformers.SwinConfig(
        embed_dim=192, depths=[2, 2, 18, 2], num_heads=[6, 12, 24, 48], window_size=12,
        out_features=["stage1", "stage2", "stage3", "stage4"],
    )  # fmt: skip
    config = transformers.OneFormerConfig(
        backbone_config=swin_large, num_labels=65, num_queries=250
    )
    return with_queries_that_differ(transformers.OneFormerForUniversalSegmentation(config))


def with_queries_that_differ(net):
    """OneFormer, whose queries are all alike, and so are a mask's pixels, before any training.

    Only the last layer's sight is sharpened: sharper ones before it make a network of random
    weights chaotic, so that rounding alone gives another mask. Classes that all queries prefer are
    levelled.
    """
    import torch

    gains = {
        "queries_embedder": 50.0,
        "decoder.layers.8.cross_attn": 5.0,
        "class_embed": 20.0,
        "mask_embed.layers.2": 3.0,
    }
    module = net.eval().model.transformer_module
    for name, weights in module.named_parameters():
        if weights.dim() > 1:
            weights.data *= next((gain for part, gain in gains.items() if part in name), 1.0)
    path = MANIFESTS / "oneformer_mapillary.yaml"
    manifest = validated(Manifest, read_yaml(path), str(path))
    seen = torch.from_numpy(tensor_of(photograph(), manifest.input))
    with torch.no_grad():
        given = net(pixel_values=seen, task_inputs=torch.arange(77)[None])
    module.decoder.class_embed.bias.data -= given.class_queries_logits[0].mean(0)
    return net


@pytest.fixture
def exported(tmp_path, monkeypatch) -> Export:
    """Function: run the page's command for a network in an empty folder, with random weights."""
    needs = "needs torch, onnx, onnxscript and transformers, as docs/poles/models.md says"
    torch = pytest.importorskip("torch", reason=needs)
    transformers = pytest.importorskip("transformers", reason=needs)
    for module in ("onnx", "onnxscript"):
        pytest.importorskip(module, reason=needs)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)

    def export(name: str) -> tuple[Any, Path]:
        net = published(name).eval()
        size = sum(weights.numel() for weights in net.parameters())
        assert size == pytest.approx(PARAMETERS[name], rel=0.03)
        tokens = type("Tokens", (), {"task_inputs": torch.arange(77)[None]})
        with monkeypatch.context() as here:
            for loader in (
                transformers.SegformerForSemanticSegmentation,
                transformers.AutoModelForDepthEstimation,
                transformers.OneFormerForUniversalSegmentation,
            ):
                here.setattr(loader, "from_pretrained", lambda _: net)
            here.setattr(
                transformers.OneFormerProcessor, "from_pretrained", lambda _: lambda **_: tokens
            )
            here.chdir(tmp_path)
            exec(compile(block(name), str(PAGE), "exec"), {"__name__": name})
        path = tmp_path / f"{name}.yaml"
        path.write_text((MANIFESTS / path.name).read_text())
        return net, path

    yield export
    torch.set_num_threads(threads)


def photograph() -> NDArray[np.uint8]:
    """Road below sky with a post, so that a network of any weights sees more than one colour."""
    image = np.full((480, 640, 3), (200, 170, 120), np.uint8)
    road = np.array([[0, 479], [300, 240], [340, 240], [639, 479]])
    cv2.fillConvexPoly(image, road, (90, 90, 95))
    cv2.rectangle(image, (500, 120), (508, 330), (40, 60, 80), -1)
    noise = np.random.default_rng(1).normal(0.0, 8.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def run_stage(stage: str, path: Path, image: NDArray[np.uint8]) -> NDArray:
    """What a stage makes of an image; its cost is within bounds."""
    folder = path.parent
    cv2.imwrite(str(folder / "a0.png"), image)
    row = {"image": "a0.png", "route": "r", "sequence": 0, "path": "", "right_path": ""}
    # a side view, because depth of a front view must rise downwards, which random weights need not
    table = pd.DataFrame([row | {"left_path": "a0.png", "status": "ok"}])
    write_table(folder / "frames.parquet", table)
    command = [sys.executable, "-m", f"roadsight.stages.poles.{stage}", "--views", "left"]
    command += ["--frames", str(folder / "frames.parquet"), "--images", str(folder)]
    command += ["--source", str(path), "--out", str(folder / "out.zip")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=AT_MOST_S, check=False)
    assert done.returncode == 0, done.stderr
    used = re.search(r"used ([\d.]+) CPU s, at most (\d+) MiB", done.stderr)
    assert used is not None, done.stderr
    print(f"{path.stem}: {used[0]}")
    assert int(used[2]) < AT_MOST_MIB[path.stem]
    shard = ImageShard(folder / "out.zip")
    (shown,) = shard.names
    return shard.read(shown)


def compared(outputs: list, path: Path, seen: NDArray[np.float32]) -> list[NDArray]:
    """PyTorch's outputs, which the exported network's equal."""
    model = open_model(path)
    expected = [output.detach().numpy() for output in outputs]
    found = model.session.run(list(model.output_names), {model.input_name: seen})
    for own, theirs in zip(found, expected, strict=True):
        assert own.shape == theirs.shape
        error = np.abs(own - theirs).max() / theirs.std()
        print(f"{path.stem}: {theirs.shape}, greatest difference {error:.1e} of the deviation")
        assert error < 0.03
    return expected


@pytest.mark.parametrize(
    ("name", "inputs"),
    [("segformer_cityscapes", (1024, 1376)), ("oneformer_mapillary", (512, 640))],
)
def test_a_large_class_network_runs_at_its_published_size(exported: Export, name, inputs):
    net, path = exported(name)
    import torch

    image = photograph()
    manifest = open_model(path).manifest
    seen = tensor_of(image, manifest.input)
    assert seen.shape == (1, 3, *inputs)
    with torch.no_grad():
        if name == "segformer_cityscapes":
            outputs = [net(pixel_values=torch.from_numpy(seen)).logits]
        else:
            tokens = torch.arange(77)[None]
            given = net(pixel_values=torch.from_numpy(seen), task_inputs=tokens)
            outputs = [given.class_queries_logits, given.masks_queries_logits]
    expected = class_mask(compared(outputs, path, seen), manifest, image.shape[:2], name)
    mask = run_stage("segment_images", path, image)
    assert mask.shape == image.shape[:2]
    assert np.bincount(mask.ravel()).max() < 0.9 * mask.size
    expected = np.where(expected == SILENT, PixelClass.OTHER, expected)
    same = np.mean(mask == expected)
    print(f"{name}: {same:.4%} of the pixels are the same")
    assert same > 0.999


def test_a_large_depth_network_runs_at_its_published_size(exported: Export):
    """At another shape than the command's example, whose size must not stay in the network."""
    net, path = exported("depth_anything")
    import torch

    image = photograph()
    manifest = open_model(path).manifest
    seen = tensor_of(image, manifest.input)
    assert seen.shape == (1, 3, 518, 686)
    with torch.no_grad():
        outputs = [net(pixel_values=torch.from_numpy(seen)).predicted_depth]
    (found,) = compared(outputs, path, seen)
    inverse = inverse_depth([found], manifest)
    smaller = cv2.resize(inverse, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    expected = packed_depth(np.asarray(smaller, np.float32), metric=False)
    depth = run_stage("estimate_depth", path, image)
    assert depth.shape == image.shape[:2]
    error = np.abs(depth.astype(float) - expected).max() / FULL_SCALE
    print(f"depth_anything: greatest difference {error:.1e} of the range")
    assert error < 0.01
    assert depth.std() > 0.01 * FULL_SCALE
