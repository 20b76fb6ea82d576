"""Measure the networks on rendered views of sites that they were not trained on."""

from __future__ import annotations

import logging
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32
from roadsight.io.images.models import Model, open_model
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.networks import class_mask, inverse_depth, tensor_of
from roadsight.poles.sightings.metric_depth import balancing_weights, fit_metric_depth
from roadsight.stages.command import Command
from roadsight_training.measures import (
    affine_fit,
    axis_pixels,
    confusion,
    correlation,
    marking_errors,
    match_poles,
    road_border_errors,
    scores_by_class,
    true_poles,
)
from roadsight_training.samples import DEPTH_SCALE, Sample, read_samples, update_record

log = logging.getLogger("evaluate_networks")
# Limits of the distances that poles are counted by.
_BANDS_M = (0.0, 20.0, 40.0, 60.0, 100.0, np.inf)
_NEAR_M = 40.0  # Borders and markings are judged up to here.
# Depths whose ratio to the truth is below this are close (the usual measure of depth networks).
_CLOSE = 1.25
_ENOUGH_PIXELS = 50  # Fewer pixels give no correlation.
_THINNING = 20  # Every twentieth pixel of the road is fitted; all of them would take longer.
_FOOT_SHARE = 1.0 / 6.0  # Lowest part of a pole, whose depth counts as the pole's.


def evaluate_networks(
    data_path: Annotated[Path, "folder that render_dataset wrote"],
    manifests: Annotated[Path, "folder of the two manifests"],
    models: Annotated[Path, "folder of the record"],
    first_seed: int = 900,
    sites: int = 8,
) -> None:
    """Put the measures of both networks into the record."""
    views = [s for _, s in read_samples(data_path, first_seed, sites)]
    data = {"first_seed": first_seed, "sites": sites, "views": len(views)}
    record = models / "training_record.json"
    for name, measure in (("road_classes", measure_classes), ("road_depth", measure_depth)):
        model = open_model(manifests / f"{name}.yaml")
        result: dict[str, Any] = measure(model, views)
        # Least CPU seconds of one image in one thread.
        image = np.random.default_rng(0).integers(0, 255, (512, 768, 3), np.uint8, endpoint=True)
        tensor = tensor_of(image, model.manifest.input)
        timings = []
        for _ in range(7):
            start = time.process_time()
            model.session.run(list(model.output_names), {model.input_name: tensor})
            timings.append(time.process_time() - start)
        result["cpu_s_per_768_x_512_image"] = round(min(timings), 4)
        update_record(record, f"{name}.onnx", {"held_out": data | _rounded(result)})
        log.info("%s: %s", name, _rounded(result))


def measure_classes(model: Model, views: list[Sample]) -> dict[str, Any]:
    """Scores by class, errors of borders and markings, poles found by distance."""
    pixels = np.zeros((len(PixelClass),) * 2, np.int64)
    borders, markings, matches = [], [], []
    for view in views:
        outputs = _run(model, view.colour)
        found = class_mask(outputs, model.manifest, view.classes.shape, model.where)
        with np.errstate(divide="ignore"):  # infinite at the sky
            depth_m = DEPTH_SCALE / view.depth.astype(np.float64)
        near = depth_m < _NEAR_M
        pixels += confusion(found, view.classes)
        borders.append(road_border_errors(found, view.classes, near))
        markings.append(marking_errors(found, view.classes, near))
        matches.append(match_poles(found, view.classes, depth_m))
    sideways = np.concatenate([errors for errors, _, _ in markings])
    missed, invented = (sum(m[i] for m in markings) for i in (1, 2))
    feet_px = np.concatenate([m.foot_px[m.hit] for m in matches])
    return {
        "classes": scores_by_class(pixels),
        "pixel_accuracy": float(np.trace(pixels) / pixels.sum()),
        "road_border_within_40_m": _spread(np.concatenate(borders)),
        "marking_within_40_m": _spread(sideways)
        | {
            "missed_share": missed / max(missed + len(sideways), 1),
            "invented_share": invented / max(invented + len(sideways), 1),
        },
        "poles": _by_band(
            np.concatenate([m.true_m for m in matches]),
            np.concatenate([m.hit for m in matches]),
            np.concatenate([m.false_m for m in matches]),
        ),
        "pole_foot": dict(zip(("sideways", "down"), map(_spread, np.abs(feet_px.T)), strict=True)),
    }


def _run(model: Model, colour: Bytes) -> list[NDArray]:
    tensor = tensor_of(colour, model.manifest.input)
    return model.session.run(list(model.output_names), {model.input_name: tensor})


def _spread(errors: Floats) -> dict[str, float]:
    if not len(errors):
        return {"count": 0}
    return {
        "count": len(errors),
        "median_px": float(np.median(errors)),
        "percentile_90_px": float(np.percentile(errors, 90)),
    }


def _by_band(true_m: Floats, hit: Bools, false_m: Floats) -> dict[str, Any]:
    """Recall and precision of poles by true distance; a false one counts where it is seen."""
    bands = {}
    for low, high in pairwise(_BANDS_M):
        inside = (true_m >= low) & (true_m < high)
        true, hits = int(np.count_nonzero(inside)), int(np.count_nonzero(hit[inside]))
        false = int(np.count_nonzero((false_m >= low) & (false_m < high)))
        if high == np.inf:
            false += int(np.count_nonzero(np.isinf(false_m)))
        bands[f"{low:g} to {high:g} m"] = {
            "true": true,
            "recall": hits / max(true, 1),
            "precision": hits / max(hits + false, 1),
        }
    return bands


def measure_depth(model: Model, views: list[Sample]) -> dict[str, Any]:
    """Agreement of relative inverse depth, by image, then over images.

    Metres come from the pipeline's own fit to the road within 60 m, as that is what it can fit to.
    """
    rows: dict[str, list[float]] = {}
    poles = []
    for view in views:
        found = _resized(
            inverse_depth(_run(model, view.colour), model.manifest), view.classes.shape
        )
        truth = view.depth / DEPTH_SCALE
        near, road = truth > 1.0 / 60.0, (PixelClass.ROAD, PixelClass.MARKING)
        parts = {
            "all": np.ones(truth.shape, bool),
            "road": np.isin(view.classes, road) & near,
            "pole": (view.classes == PixelClass.POLE) & near,
            "road_and_pole": np.isin(view.classes, (*road, PixelClass.POLE)) & near,
        }
        for name, part in parts.items():
            if np.count_nonzero(part) >= _ENOUGH_PIXELS:
                agreement = correlation(found[part], truth[part])
                rows.setdefault(f"correlation_{name}", []).append(agreement)
        below_sky = truth > 0
        given, wanted = found[below_sky], truth[below_sky]
        scale, offset = affine_fit(given, wanted)
        ratio = np.maximum(scale * given + offset, 1e-6) / wanted
        share = float(np.mean(np.maximum(ratio, 1.0 / ratio) < _CLOSE))
        rows.setdefault("share_within_1.25_after_fit_to_all", []).append(share)
        poles.append(_pole_depths(view, found, truth, parts["road"]))
    result: dict[str, Any] = {}
    for name, values in rows.items():
        known = np.array(values)[np.isfinite(values)]
        result[name] = {
            "images": len(known),
            "median": float(np.median(known)),
            "percentile_10": float(np.percentile(known, 10)),
        }
    true_m, found_m = np.concatenate(poles, axis=1)
    return result | {"pole_foot_depth_after_fit_to_road": _pole_errors(true_m, found_m)}


def _pole_depths(view: Sample, found: Floats, truth: Floats, road: Bools) -> Floats:
    """True and found depth (2, n) of the lowest sixth of poles, metres; NaN where none is told."""
    road_m = 1.0 / truth[road][::_THINNING]
    fit = fit_metric_depth(found[road][::_THINNING], road_m, balancing_weights(road_m))
    places = [axis_pixels(one, view.classes, _FOOT_SHARE) for one in true_poles(view.classes)]
    pairs = [
        (np.median(truth[place]), np.median(found[place])) for place in places if len(place[0])
    ]
    true, seen = np.array(pairs, np.float64).reshape(-1, 2).T
    with np.errstate(divide="ignore"):
        return np.stack([1.0 / true, fit.depth_m(seen)[0]])


def _resized(found: Floats32, shape: tuple[int, int]) -> Floats:
    rows = np.minimum(
        ((np.arange(shape[0]) + 0.5) * found.shape[0] / shape[0]).astype(int), found.shape[0] - 1
    )
    columns = np.minimum(
        ((np.arange(shape[1]) + 0.5) * found.shape[1] / shape[1]).astype(int), found.shape[1] - 1
    )
    return found[np.ix_(rows, columns)].astype(np.float64)


def _pole_errors(true_m: Floats, found_m: Floats) -> dict[str, Any]:
    """Relative error of the depth of the lowest sixth of poles, by true distance."""
    error = np.abs(found_m - true_m) / true_m
    result = {}
    for low, high in ((0.0, 20.0), (20.0, 40.0), (40.0, 60.0)):
        inside = (true_m >= low) & (true_m < high)
        known = inside & np.isfinite(error)
        if known.any():
            result[f"{low:g} to {high:g} m"] = {
                "poles": int(inside.sum()),
                "known_share": float(known.sum() / inside.sum()),
                "median": float(np.median(error[known])),
                "percentile_90": float(np.percentile(error[known], 90)),
            }
    return result


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(inner) for name, inner in value.items()}
    return round(value, 4) if isinstance(value, float) else int(value)


main = Command(evaluate_networks)


if __name__ == "__main__":
    sys.exit(main())
