"""Networks as ONNX files that hold the network only, and give the same bytes every time."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import nn

_OPSET = 17


def export_network(network: nn.Module, path: str | os.PathLike[str], output: str) -> float:
    """Write ``network`` with free batch, height and width; input "image", output ``output``.

    Returns
    -------
    Largest difference between what the file and the network give on random images.
    """
    unfinished = Path(path).with_name(f".{Path(path).name}")
    network = network.eval()
    free = {0: "batch", 2: "height", 3: "width"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network, (torch.rand(1, 3, 64, 96),), str(unfinished), dynamo=False,
            opset_version=_OPSET, input_names=["image"], output_names=[output],
            dynamic_axes={"image": free, output: free},
        )  # fmt: skip
    onnx.save(_bare(onnx.load(str(unfinished))), str(unfinished))
    difference = _largest_difference(network, unfinished)
    unfinished.replace(path)
    return difference


def _bare(model: onnx.ModelProto) -> onnx.ModelProto:
    """Without notes about the source code it was made from."""
    model.producer_name, model.producer_version, model.doc_string = "roadsight", "", ""
    for node in model.graph.node:
        node.doc_string = ""
        del node.metadata_props[:]
    onnx.checker.check_model(model, full_check=True)
    return model


def _largest_difference(network: nn.Module, path: Path) -> float:
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    rng, worst = np.random.default_rng(0), 0.0
    for shape in ((1, 3, 64, 96), (2, 3, 208, 320)):
        images = rng.random(shape, np.float32)
        with torch.no_grad():
            expected = network(torch.from_numpy(images)).numpy()
        found = session.run(None, {"image": images})[0]
        worst = max(worst, float(np.abs(found - expected).max()))
    return worst
