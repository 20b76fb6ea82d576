"""Network files with their manifests, checked against each other before any image is read."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roadsight.base.arrays import AnyPath, Floats32
from roadsight.base.errors import InputError
from roadsight.base.section import check_path, validated
from roadsight.base.texts import read_yaml
from roadsight.io.records.companions import missing_weights, network_sha256, weight_files
from roadsight.placement.depth.unet import MULTIPLE_CELLS, NETWORK_MODELS, STEP_DEG
from roadsight.poles.images.networks import LabelMap, Manifest

if TYPE_CHECKING:  # stages that may need a network do not wait for its runtime until they do
    import onnxruntime
_VARIABLE = r"\$\{(\w+)\}"
_FLOAT = "tensor(float)"  # type of a network's input, by ONNX
# Types of an output of labels, by ONNX.
_LABEL_TYPES = ("tensor(uint8)", "tensor(int32)", "tensor(int64)", "tensor(float)")
_CHANNELS = 3  # networks take colour images


@dataclass(frozen=True)
class Model:
    """A network that fits its manifest.

    Parameters
    ----------
    manifest : what it expects and gives. session : its ONNX session on the CPU.
    input_name, output_names : of the tensors used. where : path of the manifest.
    """

    manifest: Manifest
    session: onnxruntime.InferenceSession
    input_name: str
    output_names: tuple[str, ...]
    where: str


def open_model(path: AnyPath, threads: int = 1) -> Model:
    """Open the network that a manifest describes, on the CPU, deterministic.

    Parameters
    ----------
    path : the manifest (YAML). threads : threads inside one operator.

    Raises
    ------
    InputError : the manifest is malformed, its file is missing, damaged or another one, or the
        network's inputs and outputs are not those that the manifest states.
    """
    where = str(path)
    manifest = validated(Manifest, read_yaml(path), where)
    for variable in re.findall(_VARIABLE, manifest.file):
        if not os.environ.get(variable):
            where = f"{Path(path)}: {manifest.file}"
            raise InputError(f"environment variable {variable} is not set", where=where)
    file = Path(path).parent / re.sub(_VARIABLE, lambda m: os.environ[m[1]], manifest.file)
    check_path(file, where)
    if not file.is_file():
        raise InputError(
            "file is missing", where=where, found=str(file), hint="see docs/poles/models.md"
        )
    if missing := missing_weights(file):
        raise InputError(
            f"weights are missing that {file.name} names",
            where=where,
            found=", ".join(str(path) for path in missing),
            hint="copy them beside the network, under the names that it was exported with",
        )
    if (
        manifest.sha256 is not None
        and (found := network_sha256(file, weight_files(file))) != manifest.sha256
    ):
        raise InputError(
            f"{file.name} is another file than this manifest is for",
            where=where,
            found=f"sha256 {found}",
            allowed=manifest.sha256,
        )
    session = open_session(file, threads)
    input_name = _checked_input(manifest, session, where)
    return Model(manifest, session, input_name, _checked_outputs(manifest, session, where), where)


def read_label_map(path: AnyPath) -> LabelMap:
    """Label map of a folder of label images.

    Raises
    ------
    InputError : it is malformed.
    """
    return validated(LabelMap, read_yaml(path), str(path))


def _checked_input(manifest: Manifest, session: onnxruntime.InferenceSession, where: str) -> str:
    inputs = {tensor.name: tensor for tensor in session.get_inputs()}
    name = manifest.input.name
    if name is None and len(inputs) == 1:
        name = next(iter(inputs))
    if name is None or name not in inputs or len(inputs) != 1:
        raise InputError(
            "needs a network with one input",
            where=f"{where}: input.name",
            found=", ".join(inputs),
            allowed=name,
            hint="export the network with its other inputs held constant",
        )
    tensor, size = inputs[name], manifest.input.size
    dynamic = size.multiple_of is not None
    wanted = (1, _CHANNELS) + ((None, None) if dynamic else (size.height_px, size.width_px))
    if not _fits(tensor.shape, wanted, dynamic) or tensor.type != _FLOAT:
        raise InputError(
            "does not match the network's input",
            where=f"{where}: input",
            found=f"{tensor.name} {_shown(tensor.shape)} {tensor.type}",
            allowed=f"{_shown(wanted)} {_FLOAT}",
        )
    return name


def _fits(shape: list[Any], wanted: tuple[int | None, ...], dynamic: bool) -> bool:
    """A network's free axis takes any length; a manifest's free axis needs a free one."""
    if len(shape) != len(wanted):
        return False
    fixed = [isinstance(length, int) for length in shape]
    if dynamic and any(fixed[2:]):
        return False
    return all(
        not is_fixed or length == want
        for length, want, is_fixed in zip(shape, wanted, fixed, strict=True)
    )


def _checked_outputs(
    manifest: Manifest, session: onnxruntime.InferenceSession, where: str
) -> tuple[str, ...]:
    outputs = {tensor.name: tensor for tensor in session.get_outputs()}
    kind, needed = manifest.output.kind, manifest.output.needed
    names = manifest.output.names or tuple(outputs)
    if len(names) != needed or not set(names) <= set(outputs):
        raise InputError(
            f"does not name the {needed} output(s) that {kind} needs",
            where=f"{where}: output.names",
            found=", ".join(names),
            allowed=", ".join(outputs),
        )
    for position, name in enumerate(names):
        _check_output(manifest, outputs[name], position, where)
    return names


def _check_output(manifest: Manifest, tensor: Any, position: int, where: str) -> None:
    """Type, number of axes, and number of labels where the file states it."""
    kind, labels = manifest.output.kind, manifest.labels
    types = _LABEL_TYPES if kind == "labels" else (_FLOAT,)
    axes = {"logits": (4,), "query_masks": ((3,), (4,))[position]}.get(kind, (2, 3, 4))
    if tensor.type not in types or len(tensor.shape) not in axes:
        raise InputError(
            f"output {tensor.name} cannot be {kind}",
            where=f"{where}: output",
            found=f"{_shown(tensor.shape)} {tensor.type}",
            allowed=f"{' or '.join(str(n) for n in axes)} axes, {' or '.join(types)}",
        )
    found = {"logits": (1, 0), "query_masks": (2, 1)}.get(kind)
    if found is None or position > 0:
        return
    axis, without_object = found
    channels = tensor.shape[axis]
    if isinstance(channels, int) and channels - without_object != labels:
        raise InputError(
            "does not state as many labels as the network has",
            where=f"{where}: labels",
            found=labels,
            allowed=channels - without_object,
        )


def _shown(shape: Any) -> str:
    return " x ".join(str(n) if isinstance(n, int) else "any" for n in shape)


# Exceptions of the runtime that a file can cause.
_ERRORS = (
    "Fail",
    "InvalidArgument",
    "InvalidGraph",
    "InvalidProtobuf",
    "NoSuchFile",
    "NotImplemented",
    "RuntimeException",
)


def open_session(file: Path, threads: int) -> onnxruntime.InferenceSession:
    """Open an ONNX file on the CPU, deterministic.

    Raises
    ------
    InputError : it is damaged or no network.
    """
    import onnxruntime  # noqa: PLC0415
    from onnxruntime.capi import onnxruntime_pybind11_state as runtime  # noqa: PLC0415

    errors = tuple(getattr(runtime, name) for name in _ERRORS)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(
            str(file), sess_options=options, providers=["CPUExecutionProvider"]
        )
    except (*errors, UnicodeDecodeError, MemoryError) as error:
        problem = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"cannot be opened as a network ({problem})", where=str(file)) from error


# What a network that refines depth maps says of itself.
_FACTS = {
    "kind": "depth_refinement",
    "step_deg": f"{STEP_DEG:g}",
    "multiple_cells": str(MULTIPLE_CELLS),
}
_HINT = "see docs/placement/depth-maps.md"


class DepthNetwork:
    """A network on the CPU that gives the same bytes every time.

    Parameters
    ----------
    path : ONNX file that `roadsight_training.train_depth_network` wrote.
    threads : threads inside one operator.

    Raises
    ------
    InputError : the file is missing, damaged or a network for something else.
    """

    def __init__(self, path: AnyPath, threads: int = 1) -> None:
        if not Path(path).is_file():
            raise InputError("no such file", where="lidar.network", found=path, hint=_HINT)
        self._session = open_session(Path(path), threads)
        self._path = str(path)
        found = self._session.get_modelmeta().custom_metadata_map
        facts = {name: found.get(name, "nothing") for name in _FACTS}
        inputs = [(tensor.name, tensor.shape[1:2]) for tensor in self._session.get_inputs()]
        outputs = [tensor.name for tensor in self._session.get_outputs()]
        if facts != _FACTS or inputs != [("depth", [1])] or outputs != ["refined"]:
            raise InputError(
                "is no network that refines depth maps of this kind",
                where=f"lidar.network, {path}",
                found=", ".join(f"{name} {value}" for name, value in facts.items()),
                allowed=", ".join(f"{name} {value}" for name, value in _FACTS.items()),
                hint=_HINT,
            )

    def __call__(self, maps: Floats32) -> Floats32:
        """Refined depth, and a score of a return if it has one, (n, 1 or 2, h, w).

        Parameters
        ----------
        maps : (n, 1, h, w), normalised.

        Raises
        ------
        InputError : the network gives something of another shape.
        """
        found: Floats32 = self._session.run(["refined"], {"depth": maps})[0]
        wanted = [(maps.shape[0], channels, *maps.shape[2:]) for channels in (1, 2)]
        if found.shape not in wanted:
            raise InputError(
                "gives a map of another shape",
                where=self._path,
                found=found.shape,
                allowed=f"{wanted[0]} or {wanted[1]}",
            )
        return found


def network_for(model: str, path: AnyPath | None) -> DepthNetwork | None:
    """Network of a model of depth maps, opened where the model needs one and a file is named.

    Raises
    ------
    InputError : as `DepthNetwork`.
    """
    return DepthNetwork(path) if path and model in NETWORK_MODELS else None
