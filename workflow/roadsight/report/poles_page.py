"""Everything that the page shows of a site's poles, as JSON content (``poles/page.json``)."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats, Ints
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.geometry.frames import Frame
from roadsight.io.raster.top_rasters import TopRaster
from roadsight.poles.images.views import View
from roadsight.poles.sightings.distances import HeightAt, road_points, sample_depth
from roadsight.poles.sightings.metric_depth import balancing_weights, fit_metric_depth
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.report.charts import hazard_profiles
from roadsight.report.packing import pack
from roadsight.report.poles_layers import (
    ACCEPTED,
    REJECTED,
    UNUSED,
    camera_layer,
    cameras_of,
    class_layer,
    edge_points,
    finite,
    pole_records,
    sighting_layer,
)
from roadsight.report.site.cautions import page_cautions, sentence, told_cautions
from roadsight.report.wording import counted, number, percent

MOST_PICTURES = 60  # Pictures of poles in the page, which holds them itself: some 5 kB each
FORMAT = "roadsight.poles-page/1"  # Of the page's content; the report refuses others
ReadImage = Callable[[str], Bytes]
# Id of a pole, the view that shows it best, and what is cut out of it
Picture = tuple[str, View, Bytes]
ReadEdges = Callable[[str], pd.DataFrame]


@dataclass(frozen=True)
class PolesResult:
    """What the poles job of a site left, all positions in local metres.

    Parameters
    ----------
    top : overhead view of the cloud. road_edges_m : LiDAR road edge (n, 3).
    frames, cameras, sightings, hazard : tables of the job, whole. owner : row of the pole of each
        sighting, -1 if none. poles : those that are kept. withheld : reasons of the others.
    image_edges : u, v of the segmented edges of an image.
    read_image : image of a path, None where the images are not at hand.
    depth_fit : of one image, or None. validation : content of validation.json, or None.
    files : names of the files that hold the poles. sections : cross-sections at poles and along
        roads. profiles : their measured heights, by pole. pictures : in the order in
        which they are shown. hidden : whether what moves is unrecognisable in them.
    """

    top: TopRaster
    road_edges_m: NDArray
    frames: pd.DataFrame
    cameras: pd.DataFrame
    sightings: pd.DataFrame
    owner: Ints
    poles: pd.DataFrame
    withheld: pd.Series
    hazard: pd.DataFrame
    image_edges: ReadEdges
    read_image: ReadImage | None
    depth_fit: dict[str, Any] | None
    validation: dict[str, Any] | None
    files: Sequence[str] = ()
    sections: pd.DataFrame = field(default_factory=pd.DataFrame)
    profiles: dict[str, Any] = field(default_factory=dict)
    pictures: Sequence[Picture] = ()
    hidden: bool = False


def build_poles_page(
    title: str, summary: dict[str, Any], about: dict[str, Any], result: PolesResult
) -> dict[str, Any]:
    """Content of ``poles/page.json``.

    Parameters
    ----------
    summary : content of summary.json. about : content of frame.json.
    """
    images = cameras_of(result.frames, result.cameras)
    # Images of unknown place are counted, but have none on the map.
    cameras = images[images[["x", "y"]].notna().all(axis=1)].reset_index(drop=True)
    owner = result.owner
    chosen = choose_images(cameras)
    names = cameras["image"].tolist()
    poles = pole_records(result.poles, names, Frame.from_dict(about))
    times = np.bincount(owner[owner >= 0], minlength=len(poles)).tolist()
    for pole, seen in zip(poles, times, strict=True):
        pole["sightings"] = seen
    dropped = result.sightings.loc[~result.sightings["kept"].astype(bool), "reason"].astype(str)
    left_out = images.loc[images["state"] != ACCEPTED, "reason"].astype(str)
    hazard = result.hazard.astype(object).to_numpy().tolist()
    return {
        "format": FORMAT,
        "title": title,
        "summary": summary,
        "frame": about,
        "counts": _counts(images, result),
        "rejections": {
            "images": _by_count(left_out),
            "sightings": _by_count(dropped),
            "poles": _by_count(result.withheld),
        },
        "layers": {
            "raster": class_layer(result.top, cameras[["x", "y"]].to_numpy()),
            "edges": edge_points(result.road_edges_m),
            "cameras": camera_layer(cameras, [names[row] for row in chosen]),
            "sightings": sighting_layer(result.sightings, owner, names),
            "poles": poles,
        },
        "images": [_image(cameras.iloc[row], result, owner) for row in chosen],
        "routes": _routes(cameras),
        "depth_fit": result.depth_fit,
        "depth_checks": depth_checks(result.sightings, owner, result.poles),
        "hazard": {
            "columns": [str(name) for name in result.hazard.columns],
            "rows": [[finite(value) for value in row] for row in hazard],
        },
        "pictures": [
            {"id": name, "image": view.image, "view": view.view, **picture(cut)}
            for name, view, cut in result.pictures
        ],
        "hidden": result.hidden,
        "hazard_profiles": hazard_profiles(result.hazard, result.sections, result.profiles),
        "validation": plain(result.validation),
        "files": list(result.files),
        "cautions": [
            *page_cautions(*told_cautions(summary.get("warnings", []))),
            *page_cautions(*pole_cautions(images, result.sightings, poles, result.validation)),
        ],
    }


def _counts(cameras: pd.DataFrame, result: PolesResult) -> dict[str, Any]:
    state = cameras["state"]
    lengths = cameras.groupby("route")["station_m"].max()
    return {
        "images": len(cameras),
        "aligned": int((state == ACCEPTED).sum()),
        "rejected": int((state == REJECTED).sum()),
        "sightings": len(result.sightings),
        "kept": int(result.sightings["kept"].sum()),
        "poles": len(result.poles),
        "routes": len(lengths),
        "length_m": float(lengths.sum()),
    }


def _by_count(reasons: pd.Series) -> list[list[Any]]:
    """Reasons with their number, most frequent first."""
    counts = reasons.value_counts().to_dict()
    return [[text, int(n)] for text, n in sorted(counts.items(), key=lambda i: (-i[1], i[0]))]


def _image(camera: pd.Series, result: PolesResult, owner: Ints) -> dict[str, Any]:
    """One embedded image with its overlay."""
    name = camera["image"]
    frame = result.frames.loc[result.frames["image"] == name].iloc[0]
    poses = result.cameras[result.cameras["image"] == name]
    own = ((result.sightings["image"] == name) & (result.sightings["view"] == "front")).to_numpy()
    image = None if result.read_image is None else result.read_image(str(frame["path"]))
    size_px = (int(frame["width_px"]), int(frame["height_px"]))
    kept = ("route", "sequence", "state", "reason", "residual_px", "yaw_deg", "lateral_m")
    return {
        "image": name,
        **{key: finite(camera[key]) for key in kept},
        "station_m": finite(camera["station_m"]),
        **({"jpeg": None} if image is None else picture(image)),
        **overlay(
            poses.iloc[0] if len(poses) else None,
            size_px,
            result.road_edges_m,
            result.image_edges(name),
            result.sightings[own],
            owner[own].tolist(),
        ),
    }


def _routes(cameras: pd.DataFrame) -> list[dict[str, Any]]:
    columns = ("station_m", "residual_px", "yaw_deg", "sigma_yaw_deg", "lateral_m")
    return [
        {
            "route": str(route),
            "state": part["state"].tolist(),
            **{
                key: [None if not np.isfinite(v) else round(float(v), 4) for v in part[key]]
                for key in (*columns, "sigma_lateral_m")
            },
        }
        for route, part in cameras.groupby("route", sort=False)
    ]


def plain(content: Any) -> Any:
    """JSON content without NaN and infinities."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    return finite(content)


# What limits the worth of located poles.

_FEW_IMAGES = 20  # Fewer images are warned of: most poles are then seen from few sides
_FEW_SIGHTINGS = 20  # Fewer sightings are warned of
_FEW_CHECKED = 10  # Fewer known poles are warned of: a mean over them says little
_LEAST_ALIGNED = 0.7  # A smaller share of aligned images is warned of
_WIDE_SIGMA_M = 5.0  # Poles with a longer major half axis (one sigma) count as uncertain
_WIDE_SHARE = 0.2  # A larger share of uncertain poles is warned of


def pole_cautions(
    cameras: pd.DataFrame,
    sightings: pd.DataFrame,
    poles: list[dict[str, Any]],
    validation: dict[str, Any] | None,
) -> tuple[list[str], list[str]]:
    """Warnings and notes.

    Parameters
    ----------
    cameras : of `cameras_of`. sightings : with kept. poles : of `pole_records`.
    validation : content of validation.json.
    """
    warnings = _image_warnings(cameras) + _result_warnings(sightings, poles)
    notes = []
    if validation is None:
        notes.append("No known poles for this site: errors and scores are not known here.")
    else:
        checked = len(validation.get("errors", []))
        own = [sentence(str(text)) for text in validation.get("warnings", [])]
        if checked < _FEW_CHECKED and not any(text.startswith("Only") for text in own):
            warnings.append(
                f"Only {counted(checked, 'pole')} could be checked against known ones: mean errors"
                " and scores rest on little data."
            )
        warnings += own
    unused = int((cameras["state"] == UNUSED).sum())
    if unused:
        notes.append(f"{counted(unused, 'image')} not used; the map says why.")
    notes.append(
        "Error ellipses come from the sightings' own uncertainties: an error that a whole route"
        " shares does not show in them."
    )
    return warnings, notes


def _image_warnings(cameras: pd.DataFrame) -> list[str]:
    used = int((cameras["state"] != UNUSED).sum())
    aligned = int((cameras["state"] == ACCEPTED).sum())
    found = []
    if used < _FEW_IMAGES:
        found.append(f"Only {counted(used, 'image')}: most poles are seen from few sides.")
    if aligned < _LEAST_ALIGNED * used:
        found.append(
            f"Only {number(aligned)} of {counted(used, 'image')} ({percent(aligned / used)}) could"
            " be aligned with the LiDAR road edge: poles beside the others are missing or rest on"
            " fewer images."
        )
    return found


def _result_warnings(sightings: pd.DataFrame, poles: list[dict[str, Any]]) -> list[str]:
    kept = int(sightings["kept"].sum())
    found = []
    if kept < _FEW_SIGHTINGS:
        found.append(f"Only {counted(kept, 'sighting')} of poles: little to triangulate from.")
    if not poles:
        return [*found, "No pole was located."]
    wide = sum((pole["sigma_major_m"] or 0.0) > _WIDE_SIGMA_M for pole in poles)
    if wide > _WIDE_SHARE * len(poles):
        found.append(
            f"{number(wide)} of {counted(len(poles), 'pole')} may be off by more than"
            f" {number(_WIDE_SIGMA_M)} m (one sigma along the longer axis)."
        )
    return found


# A few images of the route with what was projected onto them and what was found in them.

MOST_IMAGES = 24  # Images in the page, which holds them itself: each adds its bytes
WIDTH_PX = 640  # Width to which larger images are reduced
_JPEG_QUALITY = 74  # Of reduced images: small, and edges still stand out
_MOST_POINTS = 1200  # Points of each kind that are drawn on an image
# Points nearer to the camera are not drawn: they are under the vehicle or far out of the image
_NEAR_M = 3.0
_FAR_M = 80.0  # Points further from the camera are not drawn: they would crowd at the horizon
_STEPS_PER_PX = 8  # Places of drawn points are stored in eighths of a pixel


def choose_images(cameras: pd.DataFrame, most: int = MOST_IMAGES) -> list[int]:
    """Rows of the images to show, in order of the route.

    A third are rejected ones, a third those with the largest residuals, each spread evenly where
    there are too many; the rest, and what these leave free, are accepted ones at even distances.

    Parameters
    ----------
    cameras : of `cameras_of`. most : how many.
    """
    share = most // 3
    state = cameras["state"].to_numpy()
    rejected = _spread(np.flatnonzero(state == REJECTED), share)
    accepted = np.flatnonzero(state == ACCEPTED)
    residual = np.nan_to_num(cameras["residual_px"].to_numpy()[accepted], nan=-1.0)
    worst = accepted[np.argsort(-residual, kind="stable")][: min(share, len(accepted) // 4)]
    rest = accepted[~np.isin(accepted, worst)]
    even = _spread(rest, most - len(rejected) - len(worst))
    chosen = np.concatenate([rejected, worst, even])
    if len(chosen) < most:
        left = np.flatnonzero((state == REJECTED) & ~np.isin(np.arange(len(state)), chosen))
        chosen = np.concatenate([chosen, _spread(left, most - len(chosen))])
    return np.sort(chosen).astype(int).tolist()


def _spread(rows: Ints, most: int) -> Ints:
    """At most so many of the rows, evenly, first and last among them."""
    if len(rows) <= most:
        return rows
    return rows[np.unique(np.rint(np.linspace(0, len(rows) - 1, most)).astype(int))]


def picture(image: Bytes) -> dict[str, Any]:
    """JPEG in base64, at most 640 px wide.

    Parameters
    ----------
    image : (rows, columns, 3) blue, green, red.
    """
    rows, columns = image.shape[:2]
    scale = min(1.0, WIDTH_PX / columns)
    size = max(1, round(columns * scale)), max(1, round(rows * scale))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return {"jpeg": base64.b64encode(jpeg.tobytes()).decode("ascii")}


def overlay(
    pose: pd.Series | None,
    size_px: tuple[int, int],
    lidar_edges_m: NDArray,
    edges: pd.DataFrame,
    sightings: pd.DataFrame,
    poles_of_sightings: list[int],
) -> dict[str, Any]:
    """What is drawn over one image, in pixels of a copy 640 px wide.

    Parameters
    ----------
    pose : row of the camera, None if it has none. size_px : width and height of the image.
    lidar_edges_m : road edge (n, 3). edges : u, v of its segmented edges.
    sightings : in its front view. poles_of_sightings : row of the pole of each, -1 if none.
    """
    scale = min(1.0, WIDTH_PX / size_px[0])
    projected = np.empty((0, 2)) if pose is None else _projected(pose, lidar_edges_m)
    axes = []
    for row, pole in zip(sightings.to_dict("records"), poles_of_sightings, strict=True):
        top_u = row["u_min"] + row["u_max"] - row["u_foot"]
        # From the foot to the opposite end of the object's box.
        line = (row["u_foot"], row["v_foot"], top_u, row["v_min"])
        axes.append(
            {
                "line": [round(float(value * scale), 1) for value in line],
                "kept": bool(row["kept"]),
                "pole": pole,
                "reason": str(row["reason"] or ""),
                "depth_m": finite(row["depth_m"]),
            }
        )
    return {
        "width_px": round(size_px[0] * scale),
        "height_px": round(size_px[1] * scale),
        "steps_per_px": _STEPS_PER_PX,
        "lidar": _pixels(projected, scale, size_px),
        "edges": _pixels(edges[["u", "v"]].to_numpy(np.float64), scale, size_px),
        "axes": axes,
    }


def _projected(pose: pd.Series, points_m: NDArray) -> Floats:
    """Pixels of what lies in front of a camera, no nearer than 3 m and no further than 80 m."""
    names = ("x", "y", "z", "heading_deg", "pitch_deg", "roll_deg", "focal_px", "cx_px", "cy_px")
    values = [float(pose[name]) for name in names]
    if not np.isfinite(values).all():
        return np.empty((0, 2))
    near = np.hypot(points_m[:, 0] - values[0], points_m[:, 1] - values[1]) <= _FAR_M
    camera = Intrinsics(int(pose["width_px"]), int(pose["height_px"]), *values[6:])
    uv, depth_m = project(camera, cam_from_world(*values[3:6]), values[:3], points_m[near])
    uv = uv[depth_m >= _NEAR_M]
    return uv[camera.contains(uv)]


def _pixels(uv_px: Floats, scale: float, size_px: tuple[int, int]) -> dict[str, Any]:
    """Pixels in eighths of the copy's, thinned by leaving out evenly."""
    limit = np.array(size_px, np.float64) - 1.0
    known = np.isfinite(uv_px).all(axis=1)
    uv = uv_px[known].clip(0.0, limit) * scale
    order = np.lexsort((uv[:, 0], uv[:, 1]))
    return pack(np.rint(uv[_spread(order, _MOST_POINTS)] * _STEPS_PER_PX), "u2")


# How an image's relative depth becomes metres, and what it is worth (paper 2, Figure 9).

_MOST_SAMPLES = 400  # Points of the plot of a fit; more would only cover each other


def depth_fit(
    image: str, camera: ViewCamera, mask: Bytes, depth: NDArray[np.uint16], height_at: HeightAt
) -> dict[str, Any] | None:
    """Relative depth of the road against its LiDAR distance, with the fitted curve.

    Parameters
    ----------
    mask : project classes. depth : relative inverse depth, 0 = unknown. height_at : the terrain.

    Returns
    -------
    samples (distance along the optical axis and relative depth) and coefficients; None if the
    image allows no fit
    """
    uv, z = road_points(camera, mask, height_at)
    relative = sample_depth(depth, uv, mask.shape)
    known = np.isfinite(relative)
    z, relative = z[known], relative[known]
    fit = fit_metric_depth(relative, z, balancing_weights(z))
    if fit.reason:
        return None
    order = np.argsort(z, kind="stable")
    kept = order[np.unique(np.linspace(0, len(z) - 1, _MOST_SAMPLES).astype(int))]
    return {
        "image": image,
        "distance_m": z[kept].round(3).tolist(),
        "relative": relative[kept].round(5).tolist(),
        **{key: float(getattr(fit, key)) for key in ("c1", "c2", "sigma_d", "near_m", "far_m")},
        "points": int(fit.points),
    }


def depth_checks(sightings: pd.DataFrame, owner: Ints, poles: pd.DataFrame) -> dict[str, Any]:
    """Distance to the located pole and what each single source said, for sightings of poles.

    Parameters
    ----------
    owner : (n,) row of the pole of each sighting, -1 if none.
    """
    rows = np.flatnonzero(owner >= 0)
    apart = (
        poles[["x", "y"]].to_numpy(np.float64)[owner[rows]]
        - sightings[["x", "y"]].to_numpy(np.float64)[rows]
    )
    distance = np.hypot(apart[:, 0], apart[:, 1])
    checks = {}
    for source in ("network", "ground", "lidar"):
        column = f"depth_{source}_m"
        if column not in sightings:
            continue
        said = sightings[column].to_numpy(np.float64)[rows]
        known = np.isfinite(said)
        if known.any():
            checks[source] = {
                "pole_m": distance[known].round(2).tolist(),
                "said_m": said[known].round(2).tolist(),
            }
    return checks
