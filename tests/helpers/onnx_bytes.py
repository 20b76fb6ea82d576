"""Tiny ONNX networks as bytes, so that tests need no package that writes them."""

from collections.abc import Sequence

import numpy as np

FLOAT, INT64 = 1, 7


def _varint(value: int) -> bytes:
    out = b""
    while True:
        value, low = value >> 7, value & 0x7F
        out += bytes([low | (0x80 if value else 0)])
        if not value:
            return out


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _part(field: int, content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def tensor(name: str, values: np.ndarray) -> bytes:
    """Constant."""
    kind = INT64 if values.dtype == np.int64 else FLOAT
    dims = b"".join(_number(1, n) for n in values.shape)
    return dims + _number(2, kind) + _part(8, name) + _part(9, values.tobytes())


def external(name: str, shape: Sequence[int], file: str) -> bytes:
    """Constant of floats that lies in a file beside the network, from its first byte on."""
    dims = b"".join(_number(1, n) for n in shape)
    entry = _part(1, "location") + _part(2, file)
    return dims + _number(2, FLOAT) + _part(8, name) + _part(13, entry) + _number(14, 1)


def value(name: str, shape: Sequence[int | str], kind: int = FLOAT) -> bytes:
    """Input or output; a text is an axis of any length."""
    dims = b"".join(_part(1, _number(1, n) if isinstance(n, int) else _part(2, n)) for n in shape)
    return _part(1, name) + _part(2, _part(1, _number(1, kind) + _part(2, dims)))


def node(kind: str, inputs: Sequence[str], output: str, **integers: int) -> bytes:
    """One operator with whole-number attributes."""
    attributes = b"".join(
        _part(5, _part(1, name) + _number(3, number) + _number(20, 2))
        for name, number in integers.items()
    )
    names = b"".join(_part(1, name) for name in inputs)
    return names + _part(2, output) + _part(3, output) + _part(4, kind) + attributes


def network(
    nodes: Sequence[bytes], constants: Sequence[bytes], inputs: Sequence[bytes],
    outputs: Sequence[bytes],
) -> bytes:  # fmt: skip
    """Whole file."""
    graph = b"".join(
        [_part(1, n) for n in nodes] + [_part(2, "tiny")] + [_part(5, c) for c in constants]
        + [_part(11, i) for i in inputs] + [_part(12, o) for o in outputs]
    )  # fmt: skip
    return _number(1, 8) + _part(7, graph) + _part(8, _part(1, "") + _number(2, 17))


def pointwise(weights: np.ndarray, size: Sequence[int | str], labels: bool = False) -> bytes:
    """Network whose logits are weights (L, 3) times the colour of each pixel."""
    kernel = tensor("w", np.ascontiguousarray(weights, np.float32)[:, :, None, None])
    nodes = [node("Conv", ["image", "w"], "logits")]
    out = value("logits", [1, len(weights), *size])
    if labels:
        nodes.append(node("ArgMax", ["logits"], "labels", axis=1, keepdims=0))
        out = value("labels", [1, *size], INT64)
    return network(nodes, [kernel], [value("image", [1, 3, *size])], [out])


def queries(masks: np.ndarray, classes: np.ndarray, size: Sequence[int | str]) -> bytes:
    """Network with mask logits = masks (Q, 3) times colour and constant class logits (Q, L + 1)."""
    constants = [
        tensor("w", np.ascontiguousarray(masks, np.float32)[:, :, None, None]),
        tensor("c", np.ascontiguousarray(classes, np.float32)[None]),
    ]
    nodes = [node("Identity", ["c"], "class_logits"), node("Conv", ["image", "w"], "mask_logits")]
    outputs = [
        value("class_logits", [1, *classes.shape]),
        value("mask_logits", [1, len(masks), *size]),
    ]
    return network(nodes, constants, [value("image", [1, 3, *size])], outputs)
