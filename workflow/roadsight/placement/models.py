"""The ways to a depth map, by their names in the settings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from roadsight.errors import InputError
from roadsight.placement.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.unet import unet_depth, unet_mask_depth

MODELS = ("surfel", "hybrid", "preliminary", "unet", "unet_mask")

_UNETS = {"unet": unet_depth, "unet_mask": unet_mask_depth}


def model_of_points(
    name: str, network: str | None = None, *, min_cell_points: int = 5, neighbours: int = 10
) -> Callable[..., NDArray[np.float32]]:
    """Function of points, sensor, position and yaw that gives a depth map.

    Parameters
    ----------
    name : one of `MODELS` but surfel. network : ONNX file, for those that use one.
    min_cell_points, neighbours : as `roadsight.placement.hybrid.hybrid_depth` takes them.

    Raises
    ------
    InputError : the model needs a network and there is none, or it is not for this.
    """
    if name == "hybrid":
        return partial(hybrid_depth, min_cell_points=min_cell_points, neighbours=neighbours)
    if name not in _UNETS:
        return preliminary_depth
    if network is None:
        raise InputError("needs a network", where=name, hint="name its ONNX file")
    # Other models need not wait for the runtime of networks.
    from roadsight.io.depth_networks import DepthNetwork  # noqa: PLC0415

    return partial(_UNETS[name], run=DepthNetwork(network))
