"""Views of a shard of which label or depth images, made elsewhere, are there."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.image_shards import LabelImages
from roadsight.io.records.tables import read_table
from roadsight.poles.images.views import View, usable, views_of


def views_with_images(
    frames_path: Path,
    wanted: Sequence[str],
    shard: Shard,
    folders: Sequence[LabelImages],
    what: str,
    log: logging.Logger,
) -> tuple[list[View], list[str]]:
    """Views of the shard's usable frames, and names of those that a folder lacks.

    How many match is counted over the whole videolog, since a shard alone may have none.

    Parameters
    ----------
    wanted : names of views. what : what the folders hold, plural.

    Raises
    ------
    InputError : a folder has an image of no view.
    """
    frames, wanted = read_table(frames_path), tuple(wanted)
    everywhere = [view.path for view in views_of(usable(frames, WHOLE), wanted)]
    missing = {
        path for folder in folders for path in folder.matching(everywhere, what, log).without
    }
    views = list(views_of(usable(frames, shard), wanted))
    left_out = [view for view in views if view.path in missing]
    if left_out:
        names = ", ".join(view.path for view in left_out)
        log.warning(
            "%d images of this shard have no %s and are left out: %s", len(left_out), what, names
        )
    return [view for view in views if view.path not in missing], [v.name for v in left_out]


class Stretched:
    """Images that have other proportions than those they belong to: the first one is told."""

    def __init__(self, what: str, log: logging.Logger) -> None:
        self._what, self._log, self._told = what, log, False

    def tell(self, image: str, found: tuple[int, ...], wanted: tuple[int, ...]) -> None:
        """Log the sizes, rows and columns, of the first one."""
        if not self._told:
            text = "%s have other proportions than their images and are stretched: %s, %s for %s px"
            sizes = (f"{shape[1]} x {shape[0]}" for shape in (found, wanted))
            self._log.warning(text, self._what, image, *sizes)
            self._told = True
