"""Layers and their files: ``roads.gpkg|layername=edges``, as QGIS writes it, and shapefiles."""

from __future__ import annotations

import os
import re
from pathlib import Path

_LAYER = re.compile(r"(?P<file>.+)\|layername=(?P<layer>[^|]+)(\|.*)?", re.DOTALL)
# Beside the geometry of a shapefile: attributes, index, CRS and encoding.
_OF_SHAPEFILES = (".dbf", ".shx", ".prj", ".cpg")


def split_layer(path: str | os.PathLike[str]) -> tuple[str, str | None]:
    """File and name of the layer, None where the path names none."""
    found = _LAYER.fullmatch(os.fspath(path))
    return (os.fspath(path), None) if found is None else (found["file"], found["layer"])


def with_companions(path: str | os.PathLike[str]) -> list[str]:
    """A layer's file, and those beside it that are part of it: attributes, CRS of a shapefile."""
    file = Path(split_layer(path)[0])
    if file.suffix.lower() != ".shp":
        return [str(file)]
    ends = [end for low in _OF_SHAPEFILES for end in (low, low.upper())]
    beside = [file.with_suffix(end) for end in ends]
    return [str(file), *(str(other) for other in beside if other.is_file())]
