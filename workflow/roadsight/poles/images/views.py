"""The views of one place: front, and left and right where a videolog has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

import pandas as pd

from roadsight.base.shards import Shard

ViewName = Literal["front", "left", "right"]
VIEWS: tuple[ViewName, ...] = ("front", "left", "right")
"""Views in the order in which they are looked at."""
_PATHS = {"front": "path", "left": "left_path", "right": "right_path"}
"""Column of the frames that names each view's image."""


@dataclass(frozen=True)
class View:
    """One image of a place.

    Parameters
    ----------
    image : name of the place's (front) image. view : front, left or right.
    path : of this image in the videolog. name : of what is made from it, without extension.
    """

    image: str
    view: str
    path: str
    name: str


def view_name(image: str, view: str = "front") -> str:
    """Name under which masks and depth of a view are kept in a shard."""
    stem = str(PurePosixPath(image).with_suffix(""))
    return stem if view == "front" else f"{stem}.{view}"


def usable(frames: pd.DataFrame, shard: Shard) -> pd.DataFrame:
    """Frames of one shard that may be used, in the table's order."""
    own = frames["image"].isin(shard.dealt(frames["image"]))
    return frames[(frames["status"] == "ok") & own].reset_index(drop=True)


def views_of(frames: pd.DataFrame, wanted: tuple[str, ...] = VIEWS) -> Iterator[View]:
    """Views of each frame, front first; a path of "" or none means that there is no such view."""
    for row in frames.to_dict("records"):
        for view in VIEWS:
            path = row.get(_PATHS[view])
            if view in wanted and isinstance(path, str) and path:
                yield View(row["image"], view, path, view_name(row["image"], view))
