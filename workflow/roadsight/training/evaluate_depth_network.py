"""Judge a depth network on scenes that it was not trained on, and write that into its record."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from roadsight.base.arrays import Floats32
from roadsight.evidence.exact_ranges import WRONG_M
from roadsight.io.images.depth_networks import DepthNetwork
from roadsight.io.records.depth_pairs import STEP_M, DepthPairs, digest, read_dataset
from roadsight.placement.depth.depth_filling import fill_linearly
from roadsight.placement.depth.unet import refined
from roadsight.stages.command import Command
from roadsight.training.record import update_record

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
        found[kind] = {way: _rounded(values) for way, values in errors.items()}
        for way, values in found[kind].items():
            log.info("%s, %s: %s", kind, way, values)
    path = network_path
    update_record(path.with_name("training_record.json"), path.name, {"held_out": found})


def _rounded(values: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in values.items()}


main = Command(evaluate_depth_network)


if __name__ == "__main__":
    sys.exit(main())
