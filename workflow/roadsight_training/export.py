"""Networks to ONNX files, which give the same bytes every time, and back to go on training."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from roadsight.base.errors import InputError

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
    # Without notes about the source code it was made from, with the facts.
    model = onnx.load(str(unfinished))
    model.producer_name, model.producer_version, model.doc_string = "roadsight", "", ""
    for node in model.graph.node:
        node.doc_string = ""
        del node.metadata_props[:]
    onnx.helper.set_model_props(model, dict(facts or {}))
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, str(unfinished))
    session = onnxruntime.InferenceSession(str(unfinished), providers=["CPUExecutionProvider"])
    rng, difference = np.random.default_rng(0), 0.0
    for shape in ((1, channels, 64, 96), (2, channels, 208, 320)):
        inputs = rng.random(shape, np.float32)
        with torch.no_grad():
            expected = network(torch.from_numpy(inputs)).numpy()
        found = session.run(None, {given: inputs})[0]
        difference = max(difference, float(np.abs(found - expected).max()))
    unfinished.replace(path)
    return difference


def start_from(network: nn.Module, path: str | os.PathLike[str], images: Tensor) -> None:
    """Give ``network`` the weights of an ONNX file that was exported from one like it.

    Each batch normalisation gets the mean and variance that it sees on ``images``, and a scale and
    offset that undo them, so that the network gives what the file gives and can be trained on.

    Raises
    ------
    InputError : the file has other convolutions.
    """
    # Weight and bias of each convolution in the order of computation.
    graph = onnx.load(os.fspath(path)).graph
    held = {one.name: np.array(numpy_helper.to_array(one)) for one in graph.initializer}
    nodes = [node for node in graph.node if node.op_type == "Conv"]
    pairs = [
        (torch.from_numpy(held[node.input[1]]), torch.from_numpy(held[node.input[2]]))
        for node in nodes
    ]
    layers = _convolutions(network, images)
    if [conv.weight.shape for conv, _ in layers] != [weight.shape for weight, _ in pairs]:
        raise InputError("holds another network than the one to be trained", where=str(path))
    hooks = []
    with torch.no_grad():
        for (conv, norm), (weight, bias) in zip(layers, pairs, strict=True):
            conv.weight.copy_(weight)
            if norm is None:
                conv.bias.copy_(bias)
            else:
                hooks.append(norm.register_forward_pre_hook(_undoing(bias)))
        network.eval()(images)
    for hook in hooks:
        hook.remove()


def _convolutions(
    network: nn.Module, images: Tensor
) -> list[tuple[nn.Conv2d, nn.BatchNorm2d | None]]:
    """Convolutions in the order of computation, each with the normalisation that follows it."""
    follows = {}
    for parent in network.modules():
        children = list(parent.children())
        for conv, norm in pairwise(children):
            if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                follows[conv] = norm
    order: list[nn.Conv2d] = []
    convolutions = [one for one in network.modules() if isinstance(one, nn.Conv2d)]
    hooks = [one.register_forward_hook(lambda m, _, __: order.append(m)) for one in convolutions]
    with torch.no_grad():
        network.eval()(images)
    for hook in hooks:
        hook.remove()
    return [(conv, follows.get(conv)) for conv in order]


def _undoing(bias: Tensor) -> Callable[[nn.BatchNorm2d, tuple[Tensor]], None]:
    """Hook that makes a normalisation add ``bias`` and nothing else."""

    def set_up(norm: nn.BatchNorm2d, inputs: tuple[Tensor]) -> None:
        mean = inputs[0].mean(dim=(0, 2, 3))
        variance = inputs[0].var(dim=(0, 2, 3))
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(variance)
        norm.weight.copy_((variance + norm.eps).sqrt())
        norm.bias.copy_(bias + mean)

    return set_up
