"""Two classes of ground, smooth and rough, by k-means on FPFH (paper 1, section 2.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.base.errors import InputError

_ALIKE = 1e-3
"""Per cent; histograms that differ by less differ by rounding."""
_TWO_TONES_APART = 2.85
"""Distance of the means of two groups, in spreads of a group. The halves of one Gaussian, clipped
as tones are, lie 2.72 apart, up to 2.80 in samples of 4,000. Tones of the ground of Delft are 2.5
apart (brick streets as bright as gardens), of other towns and a suburb from the air 3.0 to 4.4."""
_OUTLIER_SPREADS = 2.0
"""Robust spreads from the class's median. Delft, where tone forms no groups: recall 79 % at a
precision of 73 without, 76 at 81 with it, 72 at 82 with 1.25. Roughness, where tone does: woods
beside an arterial, as dark as asphalt, are left out; a street of Amsterdam keeps its F1 (80 %)."""


@dataclass(frozen=True)
class SmoothnessModel:
    """Fitted classes; `is_smooth` applies them.

    Parameters
    ----------
    mean, scale : normalisation of the 33 histogram bins: (33,) mean, one common scale.
    intensity_mean, intensity_scale : normalisation of intensity; scale infinite if unused.
    centres : (2, 34) class centres in normalised space. smooth : number of the smooth class.
    tone_range, roughest : outliers of the cue that did not part the classes are not smooth: the
        intensity that counts, and the greatest surface variation.
    """

    mean: Floats
    scale: float
    intensity_mean: float
    intensity_scale: float
    centres: Floats
    smooth: int
    tone_range: tuple[float, float] = (-np.inf, np.inf)
    roughest: float = np.inf

    @property
    def by_tone(self) -> bool:
        """Whether intensity took part in forming the classes."""
        return bool(np.isfinite(self.intensity_scale))


def local_intensity(intensity: Floats, neighbours: Ints) -> Floats:
    """Median intensity of each point and its neighbours (n, k), -1 where missing."""
    group = np.concatenate([np.arange(len(intensity))[:, None], neighbours], axis=1)
    return np.nanmedian(np.where(group >= 0, intensity[group], np.nan), axis=1)


def fit_smoothness(
    histograms: Floats32,
    variation: Floats,
    intensity: Floats | None,
    intensity_weight: float,
    seed: int,
    judge: bool = False,
) -> SmoothnessModel:
    """k-means with k = 2; the smooth class has the smaller surface variation (and is darker).

    Bins share one scale, so that empty bins add no noise; intensity, where used, is clipped to its
    1st to 99th percentile and weighs ``intensity_weight`` against the whole histogram. Points
    without a normal carry NaN variation and are left out. Where all points are alike there is one
    class, and it is smooth.

    Parameters
    ----------
    histograms : (n, 33) FPFH; variation : (n,); intensity : (n,) or None to do without.
    judge : intensity forms the classes only where it has two groups itself. The cue that does not
        form them, intensity or roughness, takes its outliers from the smooth class.

    Raises
    ------
    InputError : fewer than two points with a normal.
    """
    known = np.isfinite(variation)
    if known.sum() < 2:
        raise InputError(
            "no ground with a surface", found=f"{known.sum()} points", allowed="at least 2"
        )
    shapes, roughness = histograms[known].astype(np.float64), variation[known]
    tones = np.zeros(len(shapes)) if intensity is None else intensity[known]
    judge = judge and intensity is not None
    if judge and not two_tones(tones, seed):
        plain = fit_smoothness(histograms[known], roughness, None, intensity_weight, seed)
        smooth = is_smooth(plain, histograms[known], roughness, tones)
        return replace(plain, tone_range=_usual_range(tones[smooth]))
    scale = max(float(np.sqrt(shapes.var(axis=0).sum())), _ALIKE)
    tone_mean, tone_scale = _tone_range(tones, intensity_weight)
    model = SmoothnessModel(
        shapes.mean(axis=0), scale, tone_mean, tone_scale, np.zeros((2, 34)), smooth=0
    )
    if scale == _ALIKE and np.isinf(tone_scale):
        return model
    from sklearn.cluster import KMeans  # noqa: PLC0415  # slow to load

    space = _normalise(model, shapes, tones)
    with threadpool_limits(1):  # sums over several threads depend on their number
        means = KMeans(n_clusters=2, n_init=4, random_state=seed).fit(space)
    level = max(float(roughness.mean()), 1e-12)
    rough = [roughness[means.labels_ == label].mean() / level for label in (0, 1)]
    rank = np.array(rough) + means.cluster_centers_[:, -1]
    model = replace(model, centres=means.cluster_centers_, smooth=int(rank.argmin()))
    if not judge:
        return model
    varied = roughness[(means.labels_ == model.smooth) & (roughness > 0)]
    return replace(model, roughest=float(np.exp(_usual_range(np.log(varied))[1])))


def two_tones(tones: Floats, seed: int) -> bool:
    """Whether intensities (n,) form two groups, farther apart than the halves of one Gaussian."""
    clipped = np.clip(tones, *np.percentile(tones, [1, 99]))[:, None]
    if np.ptp(clipped) == 0:
        return False
    from sklearn.cluster import KMeans  # noqa: PLC0415  # slow to load

    with threadpool_limits(1):
        means = KMeans(n_clusters=2, n_init=4, random_state=seed).fit(clipped)
    within = (means.inertia_ / len(clipped)) ** 0.5
    return bool(np.ptp(means.cluster_centers_) > _TWO_TONES_APART * within)


def _usual_range(values: Floats) -> tuple[float, float]:
    """Values that are no outliers; all of them where most are alike, or there are none."""
    if len(values) == 0:
        return -np.inf, np.inf
    middle = float(np.median(values))
    # 1.4826: the spread of a Gaussian whose median deviation this is.
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    reach = _OUTLIER_SPREADS * spread if spread > 0 else np.inf
    return middle - reach, middle + reach


def _tone_range(tones: Floats, weight: float) -> tuple[float, float]:
    """Mean and scale of intensity between its 1st and 99th percentile; infinite if constant."""
    clipped = np.clip(tones, *np.percentile(tones, [1, 99]))
    scale = float(clipped.std()) / weight if np.ptp(clipped) > 0 else np.inf
    return float(clipped.mean()), scale


def is_smooth(
    model: SmoothnessModel,
    histograms: Floats32,
    variation: Floats,
    intensity: Floats,
) -> Bools:
    """Smooth points (n,); a point without a normal is never smooth."""
    space = _normalise(model, histograms.astype(np.float64), intensity)
    distance = ((space[:, None, :] - model.centres[None]) ** 2).sum(axis=2)
    darkest, brightest = model.tone_range
    odd = (intensity < darkest) | (intensity > brightest) | (variation > model.roughest)
    return ~odd & (distance.argmin(axis=1) == model.smooth) & np.isfinite(variation)


def _normalise(model: SmoothnessModel, histograms: Floats, intensity: Floats) -> Floats:
    limit = 3.0 * model.intensity_scale
    tone = np.clip(intensity - model.intensity_mean, -limit, limit) / model.intensity_scale
    return np.column_stack([(histograms - model.mean) / model.scale, np.nan_to_num(tone)])
