"""Sightings: where an image says that poles stand, seen from its camera (paper 2, 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.base.sections.poles import Sightings
from roadsight.geometry.cameras import azimuth_deg, wrap_deg
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.images.pole_masks import Instance, find_instances, published_instances
from roadsight.poles.images.views import PUBLISHED_HEIGHT_PX
from roadsight.poles.sightings.distances import (
    HeightAt,
    behind_plants,
    fit_view_depth,
    foot_distances,
    ground_distances,
    network_distances,
)
from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.poles.sightings.metric_depth import DepthFit, fuse_depths
from roadsight.poles.sightings.sighting_bearing import (
    OWN_COLUMN,
    SNAP_DEPTHS,
    TURNED_COLUMNS,
    ViewCamera,
    image_bearings,
    matching_columns,
    nearest_projected,
    turned_by_camera,
    with_place,
)

# Error of a network's distances that an image has in common, as a share of the distance.
_MODEL_SHARE = 0.05


# What the published ways know of columns.
_NO_COLUMNS = PoleColumns(np.empty((0, 2)), np.empty(0), np.empty(0))
_SIGMA_AXIS_PX = 2.0  # error of an axis across; px of an image 1200 px high
_SIGMA_FOOT_PX = 8.0  # error of a foot down such an image
_SIGMA_GROUND_M = 0.1  # error of the camera's height above the terrain at a foot
_TALLEST_PX = 1e6  # more than any image is tall: what is preferred at any height
# Share of the least height that a mask shows of a pole whose column in the cloud is taller.
# Delineators and bushes before columns are lower. Of 60 sightings on four generated roads that are
# lower than a pole may be and match a column, 15 are of poles.
_SHOWN_SHARE = 0.5
_NEAREST_M = 2.0  # nearer objects are dropped
_SIGN_POST_M = 4.5  # a pole that touches a sign and is lower than this carries it


@dataclass(frozen=True)
class Evidence:
    """What the site knows about a place.

    Parameters
    ----------
    height_at : terrain. columns : pole-like LiDAR columns. points_m : points of the cloud (n, 3)
    within reach, only for the published bearing. seen_from_m : (2,) the videolog's place of the
    camera, from which the published bearing is taken.
    """

    height_at: HeightAt
    columns: PoleColumns
    points_m: Floats
    seen_from_m: tuple[float, float] | None = None


def measure_view(
    camera: ViewCamera,
    mask: Bytes,
    depth: NDArray[np.uint16] | None,
    evidence: Evidence,
    settings: Sightings | None = None,
    front_fit: DepthFit | None = None,
) -> pd.DataFrame:
    """Sightings in one view, kept or not, left to right within each kind.

    Parameters
    ----------
    camera : of the view. mask : project classes (rows, columns). depth : relative inverse depth of
        any size, or None. front_fit : of the place's front view, for the published distance.

    Returns
    -------
    a row for each object: kind, pixels of foot and box, bearing_grid_deg, depth_m (horizontal) and
    their sigmas, each distance by itself, height_m, lower_edge_rise and upper_edge_rise (of a
    panel's, m per m of plan), kept and reason
    """
    settings = settings or Sightings()
    kinds = [kind for kind in settings.kinds if not KINDS[kind].from_cloud]
    found: list[Instance] = []
    for kind in kinds:
        published = settings.mask_rule == "published" and kind == "pole"
        found += published_instances(mask) if published else find_instances(mask, kind, settings)
    scale = mask.shape[0] / PUBLISHED_HEIGHT_PX
    names = ("kind", "u_foot", "v_foot", "u_min", "v_min", "u_max", "v_max", "width_px", "reason")
    table = pd.DataFrame([{n: getattr(one, n) for n in names} for one in found], columns=names)
    table["cut_side"] = [bool(one.cut & {"left", "right"}) for one in found]
    if not found:
        return table
    if settings.distance == "published":
        # The network alone, at the foot, without errors (section 3.3.1).
        network, ground = np.full((2, 2, len(found)), np.nan)
        hidden = np.zeros(len(found), bool)
        if depth is not None and front_fit is not None:
            network[0] = foot_distances(camera, found, depth, front_fit, mask.shape)
    else:
        network, ground, hidden = _own_distances(camera, found, mask, depth, evidence, settings)
    table["foot_visible"] = ~hidden
    prior, prior_sigma = np.array(
        [fuse_depths(*pair)[:2] for pair in zip(*_stack(network, ground), strict=True)]
    ).T
    feet = table[["u_foot", "v_foot"]].to_numpy()
    width = table["width_px"].to_numpy()
    sigma_u = np.hypot(np.maximum(_SIGMA_AXIS_PX * scale, 0.5), 0.1 * width)
    bearing, sigma = image_bearings(camera, feet, sigma_u)
    turned = turned_by_camera(camera, feet)
    table[list(TURNED_COLUMNS)] = turned
    table[OWN_COLUMN] = np.sqrt(np.maximum(sigma**2 - (turned**2).sum(axis=1), 0.0))
    rises = np.column_stack([_rise(camera, feet), _rise(camera, table[["u_foot", "v_min"]])])
    told = np.array([one.foot == "visible" for one in found]) | np.isnan(ground[0])
    panel = np.array([KINDS[one.kind].shape == "panel" for one in found])
    rises[told] = np.nan
    tops = np.where(panel, _rise(camera, table[["u_foot", "v_min"]]), np.nan)
    match = matching_columns(
        camera,
        evidence.columns if settings.distance == "fused" else _NO_COLUMNS,
        bearing,
        sigma,
        prior,
        prior_sigma,
        settings.farthest_m,
        rises,
        tops,
    )
    lidar = _column_distances(camera, evidence.columns, match)
    place = camera.sigma_towards_m(bearing)
    for other in (network, ground):
        with np.errstate(invalid="ignore"):
            sigma_m = np.sqrt(other[1] ** 2 + lidar[1] ** 2 + place**2)
            off = np.abs(other[0] - lidar[0]) > SNAP_DEPTHS * sigma_m
        other[:, off] = np.nan
    ways = {"network": network, "ground": ground, "lidar": lidar}
    table = _with_depths(table, ways, settings.distance == "fused")
    table = _with_sizes(table, found, camera)
    sigma = with_place(camera, bearing, sigma, table["depth_m"].fillna(settings.farthest_m))
    bearing, sigma, method = _chosen_bearing(
        camera, (bearing, sigma), match, evidence, feet, settings
    )
    table["bearing_grid_deg"], table["sigma_bearing_deg"], table["method"] = bearing, sigma, method
    table["sigma_place_m"] = place
    table["width_deg"] = np.degrees(np.arctan(width / camera.intrinsics.focal_px))
    middle = 0.5 * (table["u_min"] + table["u_max"])
    for name, row in (("lower_edge_rise", "v_max"), ("upper_edge_rise", "v_min")):
        edge = _rise(camera, np.column_stack([middle, table[row]]))
        table[name] = np.where(panel, edge, np.nan)
    return _judged(table, found, match, camera, settings)


def _own_distances(
    camera: ViewCamera,
    found: Sequence[Instance],
    mask: Bytes,
    depth: NDArray[np.uint16] | None,
    evidence: Evidence,
    settings: Sightings,
) -> tuple[Floats, Floats, Bools]:
    """Distance and sigma (2, n) by the network and by the ground, and whether feet are hidden."""
    network = np.full((2, len(found)), np.nan)
    hidden = np.array([one.foot == "hidden" for one in found])
    if depth is not None and depth.any():
        fit = fit_view_depth(camera, mask, depth, evidence.height_at)
        network = np.array(network_distances(camera, found, depth, fit, mask.shape))
        hidden |= behind_plants(camera, found, depth, fit, evidence.height_at, mask.shape)
    # A network takes a panel for what is behind it: what it says of one is no distance.
    network[:, [KINDS[one.kind].shape == "panel" for one in found]] = np.nan
    # A network's error is shared by a whole image: scatter about the fit does not show it.
    network[1] = np.hypot(network[1], _MODEL_SHARE * network[0])
    reach_px = max(_SIGMA_FOOT_PX * mask.shape[0] / PUBLISHED_HEIGHT_PX, 1.0)
    ground = np.array(
        ground_distances(
            camera, found, evidence.height_at, reach_px, _SIGMA_GROUND_M, 2.0 * settings.farthest_m
        )
    )
    ground[:, hidden] = np.nan
    return network, ground, hidden


def _rise(camera: ViewCamera, uv_px: ArrayLike) -> Floats:
    """Rise per metre of plan (n,) of the rays of pixels (n, 2)."""
    rays = camera.rays(uv_px)
    return np.asarray(rays[:, 2] / np.hypot(rays[:, 0], rays[:, 1]), np.float64)


def _stack(*pairs: NDArray) -> tuple[Floats, Floats]:
    """Distances (n, k) and sigmas (n, k) from pairs of them (2, n)."""
    return np.stack([p[0] for p in pairs], axis=1), np.stack([p[1] for p in pairs], axis=1)


def _column_distances(camera: ViewCamera, columns: PoleColumns, match: Ints) -> Floats:
    """Horizontal distance and sigma (2, n) of the columns that sightings match.

    Seen from where the camera is believed to be, a column's distance has no error of the camera's
    place, as its direction has none: the ray ends at the column wherever the camera truly was.
    """
    found = np.full((2, len(match)), np.nan)
    known = match >= 0
    offset = columns.xy_m[match[known]] - np.asarray(camera.position_m[:2])
    found[0, known] = np.hypot(offset[:, 0], offset[:, 1])
    found[1, known] = columns.sigma_m[match[known]]
    return found


def _with_depths(table: pd.DataFrame, pairs: dict[str, NDArray], fused: bool) -> pd.DataFrame:
    """Distances by each method, and the one that is used: fused, or the network's alone."""
    columns: dict[str, Any] = {}
    for name, (distance, sigma) in pairs.items():
        columns[f"depth_{name}_m"], columns[f"sigma_depth_{name}_m"] = distance, sigma
    if not fused:
        columns |= {"depth_m": pairs["network"][0], "sigma_depth_m": np.nan}
        return table.assign(**columns, depth_from="network")
    together = [fuse_depths(*pair) for pair in zip(*_stack(*pairs.values()), strict=True)]
    names = np.array(list(pairs))
    sources = ["+".join(names[one[2]]) for one in together]
    lidar = pairs["lidar"]
    # A ray that ends at a column ends there: other distances have the error of the camera's place.
    ends = np.isfinite(lidar[0])
    columns["depth_m"] = np.where(ends, lidar[0], [one[0] for one in together])
    columns["sigma_depth_m"] = np.where(ends, lidar[1], [one[1] for one in together])
    columns["depth_from"] = np.where(ends, "lidar", np.array(sources, dtype=object))
    return table.assign(**columns)


def _with_sizes(table: pd.DataFrame, found: Sequence[Instance], camera: ViewCamera) -> pd.DataFrame:
    """Distances of panels that nothing else tells, by how large their kind is."""
    size_m, sigma = np.array([(KINDS[o.kind].size_m, KINDS[o.kind].size_sigma) for o in found]).T
    away_m = size_m * camera.intrinsics.focal_px / np.sqrt([o.pixels for o in found])
    told = np.isfinite(away_m) & table["depth_m"].isna().to_numpy()
    table.loc[told, "depth_m"] = away_m[told]
    table.loc[told, "sigma_depth_m"] = (sigma * away_m)[told]
    table.loc[told, "depth_from"] = "size"
    return table


def _chosen_bearing(
    camera: ViewCamera,
    image: tuple[Floats, Floats],
    match: Ints,
    evidence: Evidence,
    feet: Floats,
    settings: Sightings,
) -> tuple[Floats, Floats, NDArray]:
    """Bearing, sigma and the way it was found (n,)."""
    bearing, sigma = image[0].copy(), image[1].copy()
    method = np.full(len(bearing), "image", dtype=object)
    if settings.bearing == "lidar":
        nearest = nearest_projected(camera, evidence.points_m, feet)
        known, origin = nearest >= 0, evidence.seen_from_m or camera.position_m[:2]
        offset = evidence.points_m[nearest[known], :2] - np.asarray(origin)
        bearing[known], method[known] = azimuth_deg(np.zeros(2), offset), "lidar"
    if settings.bearing == "fused":
        for i in np.flatnonzero(match >= 0):
            offset = evidence.columns.xy_m[match[i]] - np.asarray(camera.position_m[:2])
            away = float(np.hypot(*offset))
            direction = float(azimuth_deg(np.zeros(2), offset))
            own = float(np.degrees(np.arctan(evidence.columns.sigma_m[match[i]] / away)))
            share = sigma[i] ** 2 / (sigma[i] ** 2 + own**2)
            bearing[i] = (bearing[i] + share * float(wrap_deg(direction - bearing[i]))) % 360.0
            sigma[i] *= np.sqrt(1.0 - share)
            method[i] = "fused"
    return bearing, sigma, method


def _judged(
    table: pd.DataFrame,
    found: Sequence[Instance],
    match: Ints,
    camera: ViewCamera,
    settings: Sightings,
) -> pd.DataFrame:
    """Rules that need the distance; the first that fails is the reason."""
    lower = table["v_foot"] - table["v_min"]
    table["height_m"] = lower * table["depth_m"] / camera.intrinsics.focal_px
    distances = table[["depth_m", "height_m"]].to_numpy(np.float64)
    in_cloud = table["depth_lidar_m"].notna().to_numpy() & (settings.height_rule == "metric")
    in_cloud &= table["height_m"].to_numpy() >= _SHOWN_SHARE * settings.min_height_m
    reasons = [
        one.reason or _why_not(float(depth), float(height), one, camera, settings)
        for one, (depth, height) in zip(found, distances, strict=True)
    ]
    # The cloud's column is tall enough: only the part that the mask shows is low, if it is a
    # part that a pole would be known by.
    pairs = zip(reasons, in_cloud, strict=True)
    table["reason"] = ["" if known and why == "too low" else why for why, known in pairs]
    if settings.bearing == "lidar":
        lost = (table["reason"] == "") & (table["method"] != "lidar")
        table["reason"] = table["reason"].mask(lost, "no point of the cloud in view")
    table["kept"] = table["reason"] == ""
    # Of things that end at one column, the tallest is the pole. Those come first whose own distance
    # says that they end there.
    own = table[["depth_network_m", "depth_ground_m"]].notna().any(axis=1)
    tall = lower.where(table["kept"] & (match >= 0), -np.inf)
    tall = tall.where(~own, tall + _TALLEST_PX)
    best = tall.groupby([table["kind"], match]).transform("max")
    part = (table["kept"] & (match >= 0) & (tall < best)).to_numpy()
    table.loc[part, "kept"], table.loc[part, "reason"] = False, "part of another pole"
    return table


def _why_not(
    depth: float, height: float, one: Instance, camera: ViewCamera, settings: Sightings
) -> str:
    if not np.isfinite(depth):
        return "distance unknown"
    # A panel's size tells its distance to half of it: it is too far only if it is, by one sigma.
    panel = KINDS[one.kind].shape == "panel"
    nearest = depth * (1.0 - KINDS[one.kind].size_sigma) if panel else depth
    if depth < _NEAREST_M or nearest > settings.farthest_m:
        return "too near" if depth < _NEAREST_M else "too far"
    if KINDS[one.kind].shape != "stem" or settings.height_rule == "none":
        return ""
    if settings.height_rule == "metric":
        # What the frame cuts at the top may be of any height.
        height = np.inf if "top" in one.cut else height
        too_low, post = height < settings.min_height_m, height < _SIGN_POST_M
    else:
        share = (one.v_foot - one.v_min) / camera.intrinsics.height_px
        too_low = share < (0.5 if depth < 25.0 else 0.25 if depth < 50.0 else 0.0)
        post = share < 1 / 3
    if too_low:
        return "too low"
    return "sign post" if post and one.touches_sign else ""
