"""Everything that the page shows of a site's poles, as JSON content (``poles/page.json``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Ints
from roadsight.geometry.frames import Frame
from roadsight.io.raster.top_rasters import TopRaster
from roadsight.poles.images.views import View
from roadsight.report.poles.hazard_charts import hazard_profiles
from roadsight.report.poles.poles_cautions import pole_cautions
from roadsight.report.poles.poles_depth import depth_checks
from roadsight.report.poles.poles_images import choose_images, overlay, picture
from roadsight.report.poles.poles_layers import (
    ACCEPTED,
    REJECTED,
    camera_layer,
    cameras_of,
    edge_points,
    finite,
    pole_records,
    sighting_layer,
)
from roadsight.report.poles.poles_raster import class_layer
from roadsight.report.site.cautions import told_cautions

MOST_PICTURES = 60
"""Pictures of poles in the page, which holds them itself: some 5 kB each."""
FORMAT = "roadsight.poles-page/1"
"""Of the page's content; the report refuses others."""

ReadImage = Callable[[str], Bytes]
Picture = tuple[str, View, Bytes]
"""Id of a pole, the view that shows it best, and what is cut out of it."""
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
    for pole, seen in zip(poles, _seen_times(owner, len(poles)), strict=True):
        pole["sightings"] = seen
    return {
        "format": FORMAT,
        "title": title,
        "summary": summary,
        "frame": about,
        "counts": _counts(images, result),
        "rejections": _rejections(images, result.sightings) | {"poles": _by_count(result.withheld)},
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
        "hazard": _table(result.hazard),
        "pictures": [
            {"id": name, "image": view.image, "view": view.view, **picture(cut)}
            for name, view, cut in result.pictures
        ],
        "hidden": result.hidden,
        "hazard_profiles": hazard_profiles(result.hazard, result.sections, result.profiles),
        "validation": plain(result.validation),
        "files": list(result.files),
        "cautions": [
            asdict(caution)
            for caution in [
                *told_cautions(summary.get("warnings", [])),
                *pole_cautions(images, result.sightings, poles, result.validation),
            ]
        ],
    }


def _seen_times(owner: Ints, poles: int) -> list[int]:
    return np.bincount(owner[owner >= 0], minlength=poles).tolist()


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


def _rejections(cameras: pd.DataFrame, sightings: pd.DataFrame) -> dict[str, list[list[Any]]]:
    """Why images and sightings were left out, most frequent reason first."""
    dropped = sightings.loc[~sightings["kept"].astype(bool), "reason"].astype(str)
    left_out = cameras.loc[cameras["state"] != ACCEPTED, "reason"].astype(str)
    return {"images": _by_count(left_out), "sightings": _by_count(dropped)}


def _by_count(reasons: pd.Series) -> list[list[Any]]:
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
    """Figures of the alignment along each route."""
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


def _table(table: pd.DataFrame) -> dict[str, Any]:
    """Columns in their order, and rows."""
    rows = [[finite(value) for value in row] for row in table.astype(object).to_numpy().tolist()]
    return {"columns": [str(name) for name in table.columns], "rows": rows}


def plain(content: Any) -> Any:
    """JSON content without NaN and infinities."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    return finite(content)
