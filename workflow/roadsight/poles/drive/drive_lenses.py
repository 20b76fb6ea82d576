"""Lenses of the drives of a site: as JSON content, given or measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from roadsight.base.errors import InputError
from roadsight.geometry.lens import RadialLens

Key = tuple[str, int, int]  # Route, width and height of images that share a camera


def lens_content(
    key: Key, lens: RadialLens, corner_px: float, sigma_px: float | None, source: str
) -> dict[str, Any]:
    """JSON content of a lens; `lens_of` reads it back."""
    known = sigma_px if sigma_px is not None and np.isfinite(sigma_px) else None
    return {
        "route": key[0],
        "width_px": key[1],
        "height_px": key[2],
        "k1": float(lens.k1),
        "k2": float(lens.k2),
        "scale_px": float(lens.scale_px),
        "corner_px": float(corner_px),
        "sigma_px": known,
        "source": source,
    }


def lens_of(lenses: Sequence[Mapping[str, Any]], key: Key, shape: tuple[int, int]) -> RadialLens:
    """Lens of an image of a drive; a side view has the same one down the image.

    Parameters
    ----------
    shape : rows and columns of the image.

    Raises
    ------
    InputError : the drive is not among the lenses.
    """
    for one in lenses:
        if (one["route"], one["width_px"], one["height_px"]) == key:
            scale_px = one["scale_px"] * shape[0] / key[2]
            return RadialLens.centred(one["k1"], one["k2"], shape[1], shape[0], scale_px)
    raise InputError("a drive has no lens", where="drive profile", found=key)


def with_given(
    lenses: Sequence[Mapping[str, Any]], given: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Lenses of the drives, where the site gives one instead of the measured one.

    Parameters
    ----------
    lenses : see `lens_content`. given : k1, k2, focal_px and perhaps the route; the first one of a
        drive's route or of all routes counts.

    Raises
    ------
    InputError : a given lens cannot have made such images.
    """
    found = []
    for measured in lenses:
        key = str(measured["route"]), int(measured["width_px"]), int(measured["height_px"])
        own = next((one for one in given if one.get("route") in (None, "", key[0])), None)
        if own is None:
            found.append(dict(measured))
            continue
        lens = RadialLens.centred(own["k1"], own["k2"], *key[1:], own["focal_px"])
        lens.check(*key[1:], where=f"poles.lenses: {key[0]}")
        found.append(lens_content(key, lens, lens.corner_px(*key[1:]), 0.0, "given"))
    return found
