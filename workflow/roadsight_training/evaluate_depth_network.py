"""Judge a depth network on scenes that it was not trained on, and write that into its record."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from roadsight.base.arrays import Floats32
from roadsight.evidence.exact_highway import WRONG_M
from roadsight.io.images.models import DepthNetwork
from roadsight.io.records.depth_maps import STEP_M, DepthPairs, digest, read_dataset
from roadsight.placement.depth.unet import fill_linearly, normalised, refined
from roadsight.stages.command import Command
from roadsight_training.depth_patches import PATCH_CELLS
from roadsight_training.samples import update_record

log = logging.getLogger("evaluate_depth_network")


def map_errors(found_m: Floats32, exact_m: Floats32) -> dict[str, float]:
    """How far maps (..., rows, columns) are from the truth, 0 for no return.

    Returns
    -------
    ``wrong``: share of the cells off by more than `WRONG_M`, or with a return too many or too few;
    ``missed`` and ``invented``: the two latter alone; ``rmse_m`` and ``median_m`` where both
    return.
    """
    both = (found_m > 0) & (exact_m > 0)
    off_m = np.abs(found_m - exact_m)[both]
    missed = float(((found_m == 0) & (exact_m > 0)).mean())
    invented = float(((found_m > 0) & (exact_m == 0)).mean())
    return {
        "wrong": missed + invented + float((off_m > WRONG_M).sum() / found_m.size),
        "missed": missed,
        "invented": invented,
        "rmse_m": float(np.sqrt(np.mean(off_m**2))) if len(off_m) else 0.0,
        "median_m": float(np.median(off_m)) if len(off_m) else 0.0,
    }


def pixel_errors(pairs: Sequence[DepthPairs], network: DepthNetwork) -> dict[str, float]:
    """Error of a network's refined maps over all cells, as the paper's RMSE "at pixel level".

    Cells without return count as range 0, in both maps.

    Returns
    -------
    ``pixel_rmse_m``, and the same without normalising back: ``pixel_rmse`` (0 to 1) and
    ``patch_rmse``, the root of the squares' sum over a patch of 56 x 56 cells, which is what the
    paper's software reports of a regression; the paper does not say which its 2.53 is.
    """
    metres = normal = cells = 0.0
    for part in pairs:
        for steps, wanted in zip(part.preliminary, part.refined, strict=True):
            given_m = steps.astype(np.float32) * np.float32(STEP_M)
            range_m, mask = refined(given_m, network, wraps=False)
            off_m = np.where(mask, range_m, 0.0) - wanted.astype(np.float64) * STEP_M
            _, low, high = normalised(given_m)
            metres += float((off_m**2).sum())
            normal += float(((off_m / max(high - low, STEP_M)) ** 2).sum())
            cells += off_m.size
    pixel = float(np.sqrt(normal / max(cells, 1.0)))
    return {
        "pixel_rmse_m": round(float(np.sqrt(metres / max(cells, 1.0))), 3),
        "pixel_rmse": round(pixel, 5),
        "patch_rmse": round(PATCH_CELLS * pixel, 3),
    }


def judged(
    exact: Sequence[DepthPairs], hybrid: Sequence[DepthPairs], network: DepthNetwork
) -> dict[str, dict[str, float]]:
    """Errors of the ways to a depth map against the truth, over all maps."""
    truth = _metres(pairs.refined for pairs in exact)
    given = _metres(pairs.preliminary for pairs in exact)
    maps = {"preliminary": given, "hybrid": _metres(pairs.refined for pairs in hybrid)}
    both = [refined(one, network, wraps=False) for one in given]
    maps["unet"] = np.stack([np.where(mask, range_m, np.float32(0)) for range_m, mask in both])
    maps["unet_mask"] = np.stack(
        [fill_linearly(one, mask, wraps=False) for one, (_, mask) in zip(given, both, strict=True)]
    )
    return {way: map_errors(found, truth) for way, found in maps.items()}


def _metres(parts: Any) -> Floats32:
    return np.concatenate(list(parts)).astype(np.float32) * np.float32(STEP_M)


def evaluate_depth_network(
    data: Annotated[Path, "folder that render_depth_dataset wrote"],
    network_path: Annotated[Path, "ONNX file; the record lies beside it"],
) -> None:
    """Put what was found about each kind of scene into the record beside the network."""
    network = DepthNetwork(network_path)
    exact, hybrid = (read_dataset(data, truth) for truth in ("exact", "hybrid"))
    found: dict[str, Any] = {"sha256": digest(exact.values()), "scenes": list(exact)}
    for kind in sorted({name.partition("_")[0] for name in exact}):
        named = [name for name in exact if name.startswith(kind)]
        errors = judged([exact[n] for n in named], [hybrid[n] for n in named], network)
        found[kind] = {
            way: {name: round(value, 4) for name, value in values.items()}
            for way, values in errors.items()
        }
        found[kind]["pairs"] = pixel_errors([hybrid[n] for n in named], network)
        for way, values in found[kind].items():
            log.info("%s, %s: %s", kind, way, values)
    path = network_path
    update_record(path.with_name("training_record.json"), path.name, {"held_out": found})


main = Command(evaluate_depth_network)


if __name__ == "__main__":
    sys.exit(main())
