"""Files that belong together, as rules ask for them: of a layer, and of a network with its weights.

A layer is named ``roads.gpkg|layername=edges``, as QGIS writes it.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path

from roadsight.base.arrays import AnyPath

_LAYER = re.compile(r"(?P<file>.+)\|layername=(?P<layer>[^|]+)(\|.*)?", re.DOTALL)
# Beside the geometry of a shapefile: attributes, index, CRS and encoding.
_OF_SHAPEFILES = (".dbf", ".shx", ".prj", ".cpg")


def split_layer(path: AnyPath) -> tuple[str, str | None]:
    """File and name of the layer, None where the path names none."""
    found = _LAYER.fullmatch(os.fspath(path))
    return (os.fspath(path), None) if found is None else (found["file"], found["layer"])


def with_companions(path: AnyPath) -> list[str]:
    """A layer's file, and those beside it that are part of it: attributes, CRS of a shapefile."""
    file = Path(split_layer(path)[0])
    if file.suffix.lower() != ".shp":
        return [str(file)]
    ends = [end for low in _OF_SHAPEFILES for end in (low, low.upper())]
    beside = [file.with_suffix(end) for end in ends]
    return [str(file), *(str(other) for other in beside if other.is_file())]


# ONNX leaves large weights out of its own file.

# Key of an entry of a tensor's external data, and the length of the file's name that follows.
_LOCATION = re.compile(rb"\x0a\x08location\x12([\x01-\x7f])", re.DOTALL)


def weight_files(network: Path) -> list[Path]:
    """Files of weights that a network names and that lie beside it or below, sorted."""
    return [file for file in _named_files(network) if file.is_file()]


def missing_weights(network: Path) -> list[Path]:
    """Files of weights that a network names and that are not there, sorted."""
    return [file for file in _named_files(network) if not file.is_file()]


def _named_files(network: Path) -> list[Path]:
    """Files that a network names, beside it or below; names that lead elsewhere are none."""
    content = network.read_bytes()
    names = set()
    for found in _LOCATION.finditer(content):
        name = content[found.end() : found.end() + found[1][0]]
        names.add(name.decode("utf-8", "replace"))
    usable = [name for name in names if ".." not in Path(name).parts and "\0" not in name]
    return sorted(network.parent / name for name in usable if not Path(name).is_absolute())


def network_sha256(network: Path, weights: Iterable[Path]) -> str:
    """SHA-256 of a network's file and, one after the other, of the weights beside it."""
    digest = hashlib.sha256()
    for file in (network, *weights):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
