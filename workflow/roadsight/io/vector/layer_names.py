"""Files of several layers: ``roads.gpkg|layername=edges`` names one, as QGIS writes it."""

from __future__ import annotations

import os
import re

_LAYER = re.compile(r"(?P<file>.+)\|layername=(?P<layer>[^|]+)(\|.*)?", re.DOTALL)


def split_layer(path: str | os.PathLike[str]) -> tuple[str, str | None]:
    """File and name of the layer, None where the path names none."""
    found = _LAYER.fullmatch(os.fspath(path))
    return (os.fspath(path), None) if found is None else (found["file"], found["layer"])
