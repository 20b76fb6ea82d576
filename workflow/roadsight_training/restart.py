"""Go on training from an ONNX file, where batch normalisation is folded into the convolutions."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from roadsight.base.errors import InputError


def start_from(network: nn.Module, path: str | os.PathLike[str], images: Tensor) -> None:
    """Give ``network`` the weights of an ONNX file that was exported from one like it.

    Each batch normalisation gets the mean and variance that it sees on ``images``, and a scale and
    offset that undo them, so that the network gives what the file gives and can be trained on.

    Raises
    ------
    InputError : the file has other convolutions.
    """
    pairs = _stored(path)
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


def _stored(path: str | os.PathLike[str]) -> list[tuple[Tensor, Tensor]]:
    """Weight and bias of each convolution in the order of computation."""
    graph = onnx.load(os.fspath(path)).graph
    held = {one.name: np.array(numpy_helper.to_array(one)) for one in graph.initializer}
    nodes = [node for node in graph.node if node.op_type == "Conv"]
    return [
        (torch.from_numpy(held[node.input[1]]), torch.from_numpy(held[node.input[2]]))
        for node in nodes
    ]


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
