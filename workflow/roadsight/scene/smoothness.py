"""Two classes of ground, smooth and rough, by k-means on FPFH (paper 1, section 2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

_FLOATS = NDArray[np.float64]


@dataclass(frozen=True)
class SmoothnessModel:
    """Fitted classes; `is_smooth` applies them.

    Parameters
    ----------
    mean, scale : normalisation of the 33 histogram bins: (33,) mean, one common scale.
    intensity_mean, intensity_scale : normalisation of intensity; scale infinite if unused.
    centres : (2, 34) class centres in normalised space. smooth : number of the smooth class.
    """

    mean: _FLOATS
    scale: float
    intensity_mean: float
    intensity_scale: float
    centres: _FLOATS
    smooth: int


def local_intensity(intensity: _FLOATS, neighbours: NDArray[np.int64]) -> _FLOATS:
    """Median intensity of each point and its neighbours (n, k), -1 where missing."""
    group = np.concatenate([np.arange(len(intensity))[:, None], neighbours], axis=1)
    return np.nanmedian(np.where(group >= 0, intensity[group], np.nan), axis=1)


def fit_smoothness(
    histograms: NDArray[np.float32],
    variation: _FLOATS,
    intensity: _FLOATS | None,
    intensity_weight: float,
    seed: int,
) -> SmoothnessModel:
    """k-means with k = 2; the smooth class has the smaller surface variation (and is darker).

    Bins share one scale, so that empty bins add no noise; intensity, where used, is clipped to its
    1st to 99th percentile and weighs ``intensity_weight`` against the whole histogram. Points
    without a normal carry NaN variation and are left out.

    Parameters
    ----------
    histograms : (n, 33) FPFH; variation : (n,); intensity : (n,) or None to do without.
    """
    known = np.isfinite(variation)
    histograms, variation = histograms[known].astype(np.float64), variation[known]
    mean = histograms.mean(axis=0)
    scale = max(float(np.sqrt(histograms.var(axis=0).sum())), 1e-9)
    centre, spread = 0.0, np.inf
    if intensity is not None:
        clipped = np.clip(intensity[known], *np.percentile(intensity[known], [1, 99]))
        centre, spread = float(clipped.mean()), float(clipped.std()) / intensity_weight
        spread = spread if spread > 0 else np.inf
    model = SmoothnessModel(mean, scale, centre, spread, np.zeros((2, 34)), 0)
    values = intensity[known] if intensity is not None else np.zeros(len(variation))
    space = _normalise(model, histograms, values)
    means = KMeans(n_clusters=2, n_init=4, random_state=seed).fit(space)
    roughness = [variation[means.labels_ == label].mean() / variation.mean() for label in (0, 1)]
    rank = np.array(roughness) + means.cluster_centers_[:, -1]
    return SmoothnessModel(mean, scale, centre, spread, means.cluster_centers_, int(rank.argmin()))


def is_smooth(
    model: SmoothnessModel,
    histograms: NDArray[np.float32],
    variation: _FLOATS,
    intensity: _FLOATS,
) -> NDArray[np.bool_]:
    """Smooth points (n,); a point without a normal is never smooth."""
    space = _normalise(model, histograms.astype(np.float64), intensity)
    distance = ((space[:, None, :] - model.centres[None]) ** 2).sum(axis=2)
    return (distance.argmin(axis=1) == model.smooth) & np.isfinite(variation)


def _normalise(model: SmoothnessModel, histograms: _FLOATS, intensity: _FLOATS) -> _FLOATS:
    limit = 3.0 * model.intensity_scale
    tone = np.clip(intensity - model.intensity_mean, -limit, limit) / model.intensity_scale
    return np.column_stack([(histograms - model.mean) / model.scale, np.nan_to_num(tone)])
