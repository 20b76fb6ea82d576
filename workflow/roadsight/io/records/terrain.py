"""Triangulated terrain as an archive of its ``vertices`` and ``triangles``."""

from __future__ import annotations

import os
import zipfile

import numpy as np

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path
from roadsight.scene.terrain.tin import Terrain


def write_terrain(path: str | os.PathLike[str], terrain: Terrain) -> None:
    """Write ``vertices`` and ``triangles``; the same terrain gives the same bytes."""
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, vertices=terrain.vertices, triangles=terrain.triangles)


def read_terrain(path: str | os.PathLike[str]) -> Terrain:
    """Read what `write_terrain` wrote.

    Raises
    ------
    InputError : the file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            vertices, triangles = archive["vertices"], archive["triangles"]
        if (
            vertices.shape[1:] != (3,)
            or triangles.shape[1:] != (3,)
            or (triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices))
        ):
            raise ValueError("its arrays do not belong together")
    except (OSError, ValueError, KeyError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError(
            f"cannot be read as a terrain ({error})",
            where=str(path),
            hint="delete it and run the workflow again",
        ) from error
    return Terrain(vertices, triangles)
