"""Networks as ONNX files that hold the network only, and give the same bytes every time."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import nn

# Version of ONNX operators that the files use; a newer one would ask for a newer runtime.
_OPSET = 17


def export_network(
    network: nn.Module,
    path: str | os.PathLike[str],
    output: str,
    given: str = "image",
    *,
    channels: int = 3,
    facts: Mapping[str, str] | None = None,
) -> float:
    """Write ``network`` with free batch, height and width; input ``given``, output ``output``.

    Parameters
    ----------
    channels : of the input. facts : what the file says about itself, by name.

    Returns
    -------
    Largest difference between what the file and the network give on random inputs.
    """
    unfinished = Path(path).with_name(f".{Path(path).name}")
    network = network.eval()
    free = {0: "batch", 2: "height", 3: "width"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (torch.rand(1, channels, 64, 96),),
            str(unfinished),
            dynamo=False,
            opset_version=_OPSET,
            input_names=[given],
            output_names=[output],
            dynamic_axes={given: free, output: free},
        )
    onnx.save(_bare(onnx.load(str(unfinished)), facts or {}), str(unfinished))
    difference = _largest_difference(network, unfinished, given, channels)
    unfinished.replace(path)
    return difference


def _bare(model: onnx.ModelProto, facts: Mapping[str, str]) -> onnx.ModelProto:
    """Without notes about the source code it was made from, with the facts."""
    model.producer_name, model.producer_version, model.doc_string = "roadsight", "", ""
    for node in model.graph.node:
        node.doc_string = ""
        del node.metadata_props[:]
    onnx.helper.set_model_props(model, dict(facts))
    onnx.checker.check_model(model, full_check=True)
    return model


def _largest_difference(network: nn.Module, path: Path, given: str, channels: int) -> float:
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    rng, worst = np.random.default_rng(0), 0.0
    for shape in ((1, channels, 64, 96), (2, channels, 208, 320)):
        inputs = rng.random(shape, np.float32)
        with torch.no_grad():
            expected = network(torch.from_numpy(inputs)).numpy()
        found = session.run(None, {given: inputs})[0]
        worst = max(worst, float(np.abs(found - expected).max()))
    return worst
