"""The ways to a depth map, by their names in the settings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from roadsight.base.arrays import Floats32
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import CellFilling
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.unet import unet_depth, unet_mask_depth

_USUAL = CellFilling()

_UNETS = {"unet": unet_depth, "unet_mask": unet_mask_depth}
NETWORK_MODELS = tuple(_UNETS)
"""Those that need a network."""

Network = Callable[[Floats32], Floats32]
"""Refined depth and score of a return (n, 2, h, w) of normalised maps (n, 1, h, w)."""


def model_of_points(
    name: str,
    network: Network | None = None,
    *,
    filling: CellFilling = _USUAL,
) -> Callable[..., Floats32]:
    """Function of points, sensor, position and yaw that gives a depth map.

    Parameters
    ----------
    name : a `DepthModel` but surfel. network : for `NETWORK_MODELS`.
    filling : of sparse cells; the hybrid model alone has it.

    Raises
    ------
    InputError : the model needs a network and there is none.
    """
    if name == "hybrid":
        names = CellFilling.model_fields
        return partial(hybrid_depth, **{name: getattr(filling, name) for name in names})
    if name not in _UNETS:
        return preliminary_depth
    if network is None:
        raise InputError("needs a network", where=name, hint="name its ONNX file")
    return partial(_UNETS[name], run=network)
