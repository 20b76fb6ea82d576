"""Networks that refine depth maps: ONNX files that say of themselves what they are for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from roadsight.base.arrays import Floats32
from roadsight.base.errors import InputError
from roadsight.io.images.sessions import open_session
from roadsight.placement.depth.models import NETWORK_MODELS
from roadsight.placement.depth.normalising import MULTIPLE_CELLS, STEP_DEG

if TYPE_CHECKING:
    import onnxruntime

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
    path : ONNX file that `roadsight.training.train_depth_network` wrote.
    threads : threads inside one operator.

    Raises
    ------
    InputError : the file is missing, damaged or a network for something else.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 1) -> None:
        if not Path(path).is_file():
            raise InputError("no such file", where="lidar.network", found=path, hint=_HINT)
        self._session = open_session(Path(path), threads)
        self._path = str(path)
        found = self._session.get_modelmeta().custom_metadata_map
        facts = {name: found.get(name, "nothing") for name in _FACTS}
        if facts != _FACTS or not _refines(self._session):
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


def network_for(model: str, path: str | os.PathLike[str] | None) -> DepthNetwork | None:
    """Network of a model of depth maps, opened where the model needs one and a file is named.

    Raises
    ------
    InputError : as `DepthNetwork`.
    """
    return DepthNetwork(path) if path and model in NETWORK_MODELS else None


def _refines(session: onnxruntime.InferenceSession) -> bool:
    """Whether input and output are as they should be."""
    inputs = [(tensor.name, tensor.shape[1:2]) for tensor in session.get_inputs()]
    outputs = [tensor.name for tensor in session.get_outputs()]
    return inputs == [("depth", [1])] and outputs == ["refined"]
