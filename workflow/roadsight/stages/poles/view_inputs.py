"""Views of a shard of which label or depth images, made elsewhere, are there."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence

from roadsight.io.images.label_images import LabelImages
from roadsight.io.records.tables import read_table
from roadsight.poles.images.views import View, usable, views_of


def views_with_images(
    arguments: argparse.Namespace, folders: Sequence[LabelImages], what: str, log: logging.Logger
) -> tuple[list[View], list[str]]:
    """Views of the shard's usable frames, and names of those that a folder lacks.

    How many match is counted over the whole videolog, since a shard alone may have none.

    Parameters
    ----------
    arguments : with frames (a path), shard, shards and views. what : what the folders hold, plural.

    Raises
    ------
    InputError : a folder has an image of no view.
    """
    frames, wanted = read_table(arguments.frames), tuple(arguments.views)
    everywhere = [view.path for view in views_of(usable(frames, 0, 1), wanted)]
    missing = {
        path for folder in folders for path in folder.matching(everywhere, what, log).without
    }
    views = list(views_of(usable(frames, arguments.shard, arguments.shards), wanted))
    left_out = [view for view in views if view.path in missing]
    if left_out:
        names = ", ".join(view.path for view in left_out)
        log.warning(
            "%d images of this shard have no %s and are left out: %s", len(left_out), what, names
        )
    return [view for view in views if view.path not in missing], [v.name for v in left_out]
