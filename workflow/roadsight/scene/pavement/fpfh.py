"""Fast point feature histograms (FPFH) of ground points, the pavement stage's descriptor.

Paper 1, section 2.2: K1 neighbours, 33 bins. The descriptor follows Rusu, Blodow and Beetz (2009,
doi:10.1109/ROBOT.2009.5152473): three angles between the normals of a pair, 11 bins each, and the
simplified histograms of the neighbours added with the weight 1 / distance squared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.kernels import compiled, compiled_part
from roadsight.base.sections.scene import GroundClasses, Thinning
from roadsight.scene.grids import Grid
from roadsight.scene.pavement.open3d_engine import open3d_fpfh, open3d_normals

_USUAL = GroundClasses().thinning


@dataclass(frozen=True)
class GroundDescription:
    """Thinned ground points.

    Parameters
    ----------
    xyz_m : (n, 3) centroids of columns or cubes, local metres.
    intensity : (n,) median around each. variation : (n,) surface variation, NaN where unknown.
    histograms : (n, 33) FPFH.
    """

    xyz_m: Floats
    intensity: Floats
    variation: Floats
    histograms: Floats32


def describe_ground(
    xyz_m: Floats,
    intensity: Floats,
    column_m: float,
    neighbours: int,
    engine: Engine = OWN,
    thinning: Thinning = _USUAL,
) -> GroundDescription:
    """Thin ground points to columns or cubes and describe each.

    Parameters
    ----------
    xyz_m : (n, 3) ground points; intensity : (n,). neighbours : K1.
    engine : who computes normals and histograms.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    centroid, mean, _ = column_means(xyz_m, intensity[:, None], column_m, thinning)
    distance, near = nearest_neighbours(centroid, neighbours)
    if engine == "own":
        normals, variation = upward_normals(centroid, near)
        histograms = fpfh(centroid, normals, distance, near)
    else:
        normals, variation = open3d_normals(centroid, neighbours)
        histograms = open3d_fpfh(centroid, normals, neighbours)
    return GroundDescription(centroid, local_intensity(mean[:, 0], near), variation, histograms)


def fpfh(xyz_m: Floats, normals: Floats, distance_m: Floats, neighbours: Ints) -> Floats32:
    """FPFH of each point.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    normals : (n, 3) unit normals, oriented alike; NaN where unknown.
    distance_m, neighbours : (n, k) from `nearest_neighbours`.

    Returns
    -------
    (n, 33) float32; all zero for a point without a usable pair, which callers must not take for
    flat road.
    """
    simplified = _simplified(xyz_m, normals, neighbours)
    return _weighted(simplified, neighbours, distance_m)


BINS = 11  # Bins of each of the three angles.
FEATURES = 3 * BINS  # Numbers of a histogram.
_SAME_ANGLE = 1e-9  # Cosines that differ by less differ by rounding.


@compiled()
def _simplified(xyz: Floats, normals: Floats, neighbours: Ints) -> Floats:
    """Simplified histograms (n, 33): each third sums to 100 where every pair is usable."""
    histograms = np.zeros((len(xyz), FEATURES))
    for i in range(len(xyz)):
        present = 0
        for j in neighbours[i]:
            present += j >= 0
        if present == 0 or math.isnan(normals[i, 0]):
            continue
        share = 100.0 / present
        for j in neighbours[i]:
            if j < 0 or math.isnan(normals[j, 0]):
                continue
            a, b, c = _pair_bins(xyz, normals, i, j)
            if a >= 0:
                histograms[i, a] += share
                histograms[i, BINS + b] += share
                histograms[i, 2 * BINS + c] += share
    return histograms


@compiled_part()
def _pair_bins(xyz: Floats, normals: Floats, i: int, j: int) -> tuple[int, int, int]:
    """Bins of the three pair angles; -1 where the pair has none (coincident or collinear)."""
    dx, dy, dz = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
    length = math.sqrt(dx**2 + dy**2 + dz**2)
    if length == 0.0:
        return -1, -1, -1
    dx, dy, dz = dx / length, dy / length, dz / length
    along_i = normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz
    along_j = normals[j, 0] * dx + normals[j, 1] * dy + normals[j, 2] * dz
    first, second, phi = i, j, along_i
    # The normal closer to the line between the points is the frame's first axis. Points with the
    # same neighbours have the same normal: rounding must not choose the sign of their third angle.
    if abs(along_j) > abs(along_i) + _SAME_ANGLE:
        first, second, phi = j, i, -along_j
        dx, dy, dz = -dx, -dy, -dz
    ux, uy, uz = normals[first, 0], normals[first, 1], normals[first, 2]
    ox, oy, oz = normals[second, 0], normals[second, 1], normals[second, 2]
    vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
    size = math.sqrt(vx**2 + vy**2 + vz**2)
    if size == 0.0:
        return -1, -1, -1
    vx, vy, vz = vx / size, vy / size, vz / size
    wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    theta = math.atan2(wx * ox + wy * oy + wz * oz, ux * ox + uy * oy + uz * oz)
    alpha = vx * ox + vy * oy + vz * oz
    return _bin((theta + math.pi) / math.pi), _bin(alpha + 1), _bin(phi + 1)


@compiled_part()
def _bin(value: float) -> int:
    """Bin of a value from 0 to 2."""
    return min(BINS - 1, max(0, int(math.floor(BINS * value * 0.5))))


@compiled()
def _weighted(simplified: Floats, neighbours: Ints, distance: Floats) -> Floats32:
    """Own histogram plus the neighbours' weighted mean, each third of which sums to 100."""
    out = np.zeros(simplified.shape, dtype=np.float32)
    mixed = np.zeros(FEATURES)
    for i in range(len(simplified)):
        mixed[:] = 0.0
        for k in range(neighbours.shape[1]):
            j, apart = neighbours[i, k], distance[i, k]
            if j >= 0 and apart > 0.0:
                weight = 1.0 / apart**2
                for f in range(FEATURES):
                    mixed[f] += simplified[j, f] * weight
        for start in range(0, FEATURES, BINS):
            total = 0.0
            for f in range(start, start + BINS):
                total += mixed[f]
            scale = 100.0 / total if total > 0.0 else 0.0
            for f in range(start, start + BINS):
                out[i, f] = simplified[i, f] + scale * mixed[f]
    return out


# Neighbourhoods and oriented normals of ground points.


def nearest_neighbours(
    xyz_m: Floats, k: int, max_distance_m: float = np.inf
) -> tuple[Floats, Ints]:
    """Distances and indices of the ``k`` nearest other points.

    A point with fewer than ``k`` others (within reach) has index -1 and infinite distance there.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.

    Returns
    -------
    distance_m, index : (n, k), nearest first; the point itself is left out.
    """
    n = len(xyz_m)
    if n == 0:
        return np.empty((0, k)), np.empty((0, k), np.int64)
    reach = cKDTree(xyz_m).query(xyz_m, k=min(k + 1, n), distance_upper_bound=max_distance_m)
    distance, index = (np.asarray(part).reshape(n, -1) for part in reach)
    own = index == np.arange(n)[:, None]
    # Among exact duplicates a point may not be its own nearest: then the last neighbour makes room.
    own[~own.any(axis=1), -1] = True
    distance, index = (part[~own].reshape(n, -1) for part in (distance, index))
    short = ((0, 0), (0, k - index.shape[1]))
    distance = np.pad(distance, short, constant_values=np.inf)
    index = np.pad(index, short, constant_values=-1)
    return distance, np.where(np.isfinite(distance), index, -1)


def upward_normals(xyz_m: Floats, neighbours: Ints) -> tuple[Floats, Floats]:
    """Unit normals that point up, and surface variation, by principal components.

    The covariance is formed around each neighbourhood's own centroid, so large coordinates lose
    nothing. A point with fewer than two neighbours, or whose neighbourhood is a line, has no plane:
    its normal is NaN and its variation is NaN, so that it cannot pass for flat road.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    neighbours : (n, k) indices, -1 where missing.

    Returns
    -------
    normals : (n, 3); variation : (n,) smallest eigenvalue over the sum, 0 (plane) to 1/3.
    """
    values, vectors = np.linalg.eigh(_covariances(xyz_m, neighbours))
    normals = vectors[:, :, 0] * np.where(vectors[:, 2, 0] < 0, -1.0, 1.0)[:, None]
    total = values.sum(axis=1)
    planar = values[:, 1] > 1e-6 * np.maximum(total, 1e-12)
    normals = np.where(planar[:, None], normals, np.nan)
    variation = np.full(len(xyz_m), np.nan)
    np.divide(np.maximum(values[:, 0], 0.0), total, out=variation, where=planar)
    return normals, variation


def plane_residuals_m(xyz_m: Floats, neighbours: Ints) -> Floats:
    """Root mean square distance of each neighbourhood from its own plane, metres; shape (n,).

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    neighbours : (n, k) indices, -1 where missing; the point itself is added.
    """
    least = np.linalg.eigvalsh(_covariances(xyz_m, neighbours))[:, 0]
    return np.sqrt(np.maximum(least, 0.0))


@compiled()
def _covariances(xyz_m: Floats, neighbours: Ints) -> Floats:
    """Covariance (n, 3, 3) of each point and its neighbours, about their own centroid."""
    out = np.empty((len(xyz_m), 3, 3))
    group = np.empty((neighbours.shape[1] + 1, 3))
    for i in range(len(xyz_m)):
        count = 0
        for j in range(-1, neighbours.shape[1]):
            member = neighbours[i, j] if j >= 0 else i
            if member >= 0:
                for axis in range(3):
                    group[count, axis] = xyz_m[member, axis]
                count += 1
        for axis in range(3):
            centre = group[:count, axis].sum() / count
            for k in range(count):
                group[k, axis] -= centre
        for a in range(3):
            for b in range(a + 1):
                total = 0.0
                for k in range(count):
                    total += group[k, a] * group[k, b]
                out[i, a, b] = out[i, b, a] = total / count
    return out


def column_means(
    xyz_m: Floats, values: Floats, size_m: float, thinning: Thinning = _USUAL
) -> tuple[Floats, Floats, Ints]:
    """Centroid and mean values of each occupied grid column, row by row from the south-west.

    Ground is single-valued in plan, so it is thinned by columns and not by cubes: a sloping road
    crosses the horizontal faces of cubes, which doubles its points there and makes bands of false
    roughness (see ``docs/decisions/003-columns-not-cubes.md``). Cubes are what paper 1 takes
    (section 2.2, Table 3).

    Parameters
    ----------
    xyz_m : (n, 3) local metres. values : (n, v). size_m : side of a column or cube.
    thinning : voxels parts each column into cubes, lowest first.

    Returns
    -------
    centroids (m, 3), means (m, v), counts (m,).
    """
    columns = np.column_stack([xyz_m, values])
    if len(columns) == 0:
        return columns[:, :3], columns[:, 3:], np.empty(0, np.int64)
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], size_m)
    cells = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    if thinning == "voxels":
        layer = np.floor(xyz_m[:, 2] / size_m).astype(np.int64)
        layer -= layer.min()
        cells = cells * (layer.max() + 1) + layer
    _, inverse, count = np.unique(cells, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(inverse, c) for c in columns.T], axis=1) / count[:, None]
    return means[:, :3], means[:, 3:], count


# Two classes of ground, smooth and rough, by k-means on FPFH (paper 1, section 2.2).

_ALIKE = 1e-3  # Per cent; histograms that differ by less differ by rounding.
# Distance of the means of two groups, in spreads of a group. The halves of one Gaussian, clipped as
# tones are, lie 2.72 apart, up to 2.80 in samples of 4,000. Tones of the ground of Delft are 2.5
# apart (brick streets as bright as gardens), of other towns and a suburb from the air 3.0 to 4.4.
_TWO_TONES_APART = 2.85
# Robust spreads from the class's median. Delft, where tone forms no groups: recall 79 % at a
# precision of 73 without, 76 at 81 with it, 72 at 82 with 1.25. Roughness, where tone does: woods
# beside an arterial, as dark as asphalt, are left out; a street of Amsterdam keeps its F1 (80 %).
_OUTLIER_SPREADS = 2.0


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
    clipped = np.clip(tones, *np.percentile(tones, [1, 99]))
    varies = np.ptp(clipped) > 0
    tone_mean = float(clipped.mean())
    tone_scale = float(clipped.std()) / intensity_weight if varies else np.inf
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


def is_smooth(
    model: SmoothnessModel, histograms: Floats32, variation: Floats, intensity: Floats
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
