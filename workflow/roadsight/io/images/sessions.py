"""ONNX files opened for the CPU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from roadsight.base.errors import InputError

if TYPE_CHECKING:  # stages that may need a network do not wait for its runtime until they do
    import onnxruntime

_ERRORS = (
    "Fail",
    "InvalidArgument",
    "InvalidGraph",
    "InvalidProtobuf",
    "NoSuchFile",
    "NotImplemented",
    "RuntimeException",
)
"""Exceptions of the runtime that a file can cause."""


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
