"""Ground, pavement and road edges of a cloud."""

from __future__ import annotations

import logging
from typing import Literal

import geopandas as gpd
import numpy as np

from roadsight.api.clouds import Points, Taken, taken
from roadsight.base import SEED
from roadsight.base.arrays import Bools, Floats
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Edges, GroundFilter, Pavement
from roadsight.io.vector.vectors import native_features
from roadsight.scene.pavement.choice import choose_method
from roadsight.scene.pavement.road_surface import KnownRoad
from roadsight.scene.pavement.scan_levels import count_scans
from roadsight.scene.splines import outline_edges, spline_line
from roadsight.scene.whole import FoundRoad, ground_of, published_road, road_of, settled_road

_USUAL = Pavement()
log = logging.getLogger("roadsight")
Method = Literal["auto", "surface", "published"]
IntensityUse = Literal["auto", "use", "ignore"]


def ground(points: Points, settings: GroundFilter | None = None) -> Bools:
    """Which points are ground.

    A coarse surface says where the ground can be, pillars decide (``docs/scene/ground.md``), or the
    published rule alone (``GroundFilter(method="pillars")``, paper 1, Table 3).

    Parameters
    ----------
    points : a cloud, a path, or local metres, (n, 3) or columns x, y, z.
    settings : thresholds; None: those of ``config.yaml``.

    Returns
    -------
    (n,) True for ground, in the order of the points that take part

    Raises
    ------
    InputError : no usable cloud, or nothing lies near a plausible ground.

    Examples
    --------
    >>> import numpy as np, roadsight
    >>> rng = np.random.default_rng(1)
    >>> field = np.column_stack([rng.uniform(0, 30, (5000, 2)), rng.normal(0, 0.01, 5000)])
    >>> wall = np.column_stack([rng.uniform(10, 20, 500), np.full(500, 15), rng.uniform(1, 6, 500)])
    >>> labels = roadsight.ground(np.vstack([field, wall]))
    >>> bool(labels[:5000].mean() > 0.99), int(labels[5000:].sum())
    (True, 0)
    """
    return _ground(taken(points), settings)


def _ground(cloud: Taken, settings: GroundFilter | None = None) -> Bools:
    mask = ground_of(cloud.xyz_m, settings)
    if not mask.any():
        raise InputError("no ground found", where=cloud.where)
    return mask


def pavement(
    points: Points,
    *,
    method: Method = _USUAL.method,
    intensity: IntensityUse = _USUAL.intensity,
    ground: Bools | None = None,
    seed: int = SEED,
    seeds_xy: Floats | None = None,
    track_xy: Floats | None = None,
    engine: Engine = OWN,
) -> FoundRoad:
    """Paved road of a cloud.

    Parameters
    ----------
    points : a cloud, a path, or local metres, (n, 3) or columns x, y, z.
    method : "surface" (a surface that runs on until a kerb, grass or a wall ends it), "published"
        (FPFH and k-means, paper 1, section 2.2), or "auto": surface where the cloud tells the scans
        of a vehicle apart or a place on the road is given, else published, with the edges of the
        surface where both agree, and up to what hides its edge (eaves, cars) where not.
    intensity : whether it is a cue; auto: where points are more than 0.15 m apart.
    ground : (n,) ground labels, found if absent; the published method alone needs them.
    seeds_xy, track_xy : (k, 2) places on the road, and where a vehicle drove in order, local
        metres: the surface grows from them.
    seed : of k-means, which the published method alone has.
    engine : who computes normals, FPFH and clusters of the published method: own or open3d.

    Returns
    -------
    ``outline`` (polygons, local metres), ``points`` (n,) and ``surface_m`` (k, 3) local metres

    Raises
    ------
    InputError : no usable cloud, no pavement is found, a place with the published method, or
        another engine with the surface.

    Examples
    --------
    >>> import numpy as np, roadsight
    >>> x, y = np.random.default_rng(1).uniform([0, -7], [40, 7], (90_000, 2)).T
    >>> verge = np.abs(y) > 4  # behind kerbs of 12 cm, and rough
    >>> z = np.where(verge, 0.12, 0) + np.random.default_rng(2).normal(0, 0.003 + 0.03 * verge)
    >>> road = roadsight.pavement(np.column_stack([x, y, z]), seeds_xy=[[20, 0]])
    >>> round(road.outline.area, -1), round(float(road.points.sum() / (~verge).sum()), 2)
    (320.0, 0.99)
    """
    if method == "published" and not (seeds_xy is None and track_xy is None):
        raise InputError(
            "has no use for seeds_xy and track_xy",
            where="method",
            found=method,
            allowed="surface or auto",
        )
    if method == "surface" and engine != "own":
        raise InputError(
            "has no use for an engine", where="method", found=method, allowed="published or auto"
        )
    known = KnownRoad(_places(track_xy, "track_xy"), _places(seeds_xy, "seeds_xy"))
    return _pavement(taken(points), method, intensity, ground, seed, known, engine)


def _places(xy_m: Floats | None, name: str) -> Floats | None:
    if xy_m is None:
        return None
    places = np.asarray(xy_m, np.float64).reshape(-1, 2)
    for row in np.flatnonzero(~np.isfinite(places).all(axis=1)):
        raise InputError("is no place", where=f"{name}[{row}]", found=places[row], allowed="x, y")
    return places


def _pavement(
    cloud: Taken,
    method: Method = _USUAL.method,
    intensity: IntensityUse = _USUAL.intensity,
    ground: Bools | None = None,
    seed: int = SEED,
    known: KnownRoad | None = None,
    engine: Engine = OWN,
) -> FoundRoad:
    choice = _chosen(cloud, method, known)
    told = cloud.intensity is not None and intensity != "ignore"
    if choice == "surface" and engine != "own":
        log.warning("engine %s does nothing here: the surface needs no FPFH", engine)
    tones = cloud.intensity if told else None
    try:
        if choice == "surface":
            return road_of(cloud.xyz_m, tones, cloud.scan, known, classes=cloud.classes)[0]
        labels = _ground(cloud) if ground is None else np.asarray(ground, bool)
        values = np.zeros(len(cloud.xyz_m)) if cloud.intensity is None else cloud.intensity
        use = intensity if told else "ignore"
        road = published_road(cloud.xyz_m, labels, values, use, seed, engine)
        if method != "auto":
            return road
        return settled_road(road, cloud.xyz_m, labels, tones, cloud.classes)
    except InputError as error:
        raise InputError(str(error), where=cloud.where) from error


def _chosen(
    cloud: Taken, method: Method, known: KnownRoad | None
) -> Literal["surface", "published"]:
    """The same choice as the workflow's, but that a track decides as seeds do."""
    if method != "auto":
        return method
    given = known is not None and (known.seeds_xy is not None or known.track_xy is not None)
    scans = {"number": 1.0, "blind_share": 0.0}
    scan = cloud.scan
    if scan is not None and not given:
        scans = count_scans(lambda: [(cloud.xyz_m, scan)])
    choice = choose_method(method, given, {"extent_m": np.ptp(cloud.xyz_m, axis=0), "scans": scans})
    log.info("pavement by method %s: %s", choice.method, choice.why)
    return choice.method


def edges(
    points: Points | FoundRoad,
    *,
    method: Method = _USUAL.method,
    intensity: IntensityUse = _USUAL.intensity,
    seed: int = SEED,
    engine: Engine = OWN,
) -> gpd.GeoDataFrame:
    """Edges of the paved road as smooth lines (paper 1, section 2.3).

    Parameters
    ----------
    points : a cloud, a path, local metres ((n, 3) or columns x, y, z), or what `pavement` found.
    method, intensity, seed, engine : as `pavement` takes them; of no use for a road that was found.

    Returns
    -------
    columns edge, kind, source, length_m; lines in the CRS and units of a cloud or path, in local
    metres for an array, a table or a road that was found

    Raises
    ------
    InputError : as `pavement`, or its outline has no edge long enough to trace.

    Examples
    --------
    >>> import numpy as np, roadsight
    >>> x, y = np.random.default_rng(1).uniform([0, -7], [40, 7], (90_000, 2)).T
    >>> verge = np.abs(y) > 4
    >>> z = np.where(verge, 0.12, 0) + np.random.default_rng(2).normal(0, 0.003 + 0.03 * verge)
    >>> road = roadsight.pavement(np.column_stack([x, y, z]), seeds_xy=[[20, 0]])
    >>> lines = roadsight.edges(road)
    >>> sorted(lines["kind"]), bool(np.allclose(np.abs(lines.centroid.y), 4, atol=0.3))
    (['edge', 'edge'], True)
    """
    if isinstance(points, FoundRoad):
        return _edges(points, "points")
    cloud = taken(points)
    table = _edges(_pavement(cloud, method, intensity, None, seed, None, engine), cloud.where)
    return table if cloud.frame is None else native_features(table, cloud.frame)


def _edges(road: FoundRoad, where: str) -> gpd.GeoDataFrame:
    found = outline_edges(road.outline, road.surface_m, Edges())
    if not found:
        raise InputError("the pavement has no edge long enough to trace", where=where)
    lines = [spline_line(line) for _, line in found]
    return gpd.GeoDataFrame(
        {
            "edge": [f"{kind[0]}{number:02d}" for number, (kind, _) in enumerate(found)],
            "kind": [kind for kind, _ in found],
            "source": "automatic",
            "length_m": [line.length for line in lines],
        },
        geometry=lines,
    )
