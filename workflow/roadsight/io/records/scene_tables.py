"""Triangulated terrain as an archive of arrays, and surfels as a table."""

from __future__ import annotations

import zipfile
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import unreadable
from roadsight.io.records.atomic import atomic_path
from roadsight.io.records.tables import read_table, write_table
from roadsight.scene.surfels import Surfels
from roadsight.scene.terrain.tin import Terrain


def write_terrain(path: AnyPath, terrain: Terrain) -> None:
    """Write ``vertices`` and ``triangles``; the same terrain gives the same bytes."""
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, vertices=terrain.vertices, triangles=terrain.triangles)


def read_terrain(path: AnyPath) -> Terrain:
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
        raise unreadable("a terrain", path, error) from error
    return Terrain(vertices, triangles)


# Surfels as a table (x, y, z, nx, ny, nz, half_u_m, half_v_m in float32).

_CENTRE = ["x", "y", "z"]
_NORMAL = ["nx", "ny", "nz"]
_HALF = ["half_u_m", "half_v_m"]


def write_surfels(path: AnyPath, surfels: Surfels, about: dict[str, Any] | None = None) -> None:
    """Write surfels with a description."""
    frame = pd.DataFrame(
        np.column_stack([surfels.centre_m, surfels.normal, surfels.half_m]),
        columns=[*_CENTRE, *_NORMAL, *_HALF],
    )
    write_table(path, frame, about)


def read_surfels(path: AnyPath) -> Surfels:
    """Read surfels.

    Raises
    ------
    InputError : the file is missing or damaged.
    """
    frame = read_table(path, [*_CENTRE, *_NORMAL, *_HALF])
    return Surfels(*(frame[part].to_numpy(np.float32) for part in (_CENTRE, _NORMAL, _HALF)))
