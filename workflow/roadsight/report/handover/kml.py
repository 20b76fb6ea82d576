"""KML of a site for online maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET

import pandas as pd
import shapely

from roadsight.base.arrays import Floats
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import longitudes_latitudes
from roadsight.report.handover.layers import Layer, field_text
from roadsight.report.handover.styles import Style

_SPACE = "http://www.opengis.net/kml/2.2"
_DOT = "http://maps.google.com/mapfiles/kml/shapes/placemark_circle.png"
_DECIMALS = 8  # Of degrees: a millimetre
# Layers with more features, such as targets, are left out: online maps refuse or choke on them
_MOST_FEATURES = 500


def kml(title: str, layers: Sequence[Layer], frame: Frame) -> str:
    """Text of a ``.kml`` file; a site without CRS has no place on a map, which the file says.

    Everything lies on the ground, so that no vertical datum can lift it off.
    """
    ET.register_namespace("", _SPACE)
    root = ET.Element(_tag("kml"))
    document = ET.SubElement(root, _tag("Document"))
    _text(document, "name", title)
    if frame.crs_wkt is None:
        _text(document, "description", "The site has no coordinate reference system.")
        return _written(root)
    crowded = [layer for layer in layers if len(layer.features) > _MOST_FEATURES]
    if crowded:
        named = ", ".join(f"{layer.name} ({len(layer.features):,})" for layer in crowded)
        told = (
            f"Left out, with more than {_MOST_FEATURES} features: {named}. The GeoPackage has them."
        )
        _text(document, "description", told)
    folders: dict[str, ET.Element] = {}
    for number, layer in enumerate(layers):
        _style(document, f"s{number}", layer.style)
    for number, layer in enumerate(layers):
        if not 0 < len(layer.features) <= _MOST_FEATURES:
            continue
        if layer.group not in folders:
            folders[layer.group] = ET.SubElement(document, _tag("Folder"))
            _text(folders[layer.group], "name", layer.group)
        _folder(folders[layer.group], f"s{number}", layer, frame)
    return _written(root)


def _folder(parent: ET.Element, style: str, layer: Layer, frame: Frame) -> None:
    folder = ET.SubElement(parent, _tag("Folder"))
    _text(folder, "name", layer.name)
    _text(folder, "description", layer.about)
    geometry = layer.features.geometry.name
    records = layer.features.drop(columns=geometry).to_dict("records")
    for record, shape in zip(records, layer.features.geometry, strict=True):
        if shape is None or shape.is_empty:
            continue
        mark = ET.SubElement(folder, _tag("Placemark"))
        label = layer.style.label
        if label and label in record:
            _text(mark, "name", str(record[label]))
        _text(mark, "styleUrl", f"#{style}")
        data = ET.SubElement(mark, _tag("ExtendedData"))
        for key, value in record.items():
            if pd.notna(value):
                field = ET.SubElement(data, _tag("Data"), name=str(key))
                _text(field, "value", field_text(value))
        _geometry(mark, shape, frame)


def _geometry(mark: ET.Element, shape: Any, frame: Frame) -> None:
    parts = shapely.get_parts(shape)
    parent = mark if len(parts) == 1 else ET.SubElement(mark, _tag("MultiGeometry"))
    for part in parts:
        if part.geom_type == "Polygon":
            polygon = ET.SubElement(parent, _tag("Polygon"))
            for tag, rings in (
                ("outerBoundaryIs", [part.exterior]),
                ("innerBoundaryIs", part.interiors),
            ):
                for ring in rings:
                    bounded = ET.SubElement(polygon, _tag(tag))
                    line = ET.SubElement(bounded, _tag("LinearRing"))
                    _text(line, "coordinates", _coordinates(ring, frame))
        else:
            element = ET.SubElement(parent, _tag(part.geom_type))
            if part.geom_type == "LineString":
                _text(element, "tessellate", "1")
            _text(element, "coordinates", _coordinates(part, frame))


def _coordinates(shape: Any, frame: Frame) -> str:
    xy: Floats = shapely.get_coordinates(shape)
    degrees = longitudes_latitudes(frame, xy)
    assert degrees is not None  # the caller has left sites without CRS out
    return " ".join(f"{lon:.{_DECIMALS}f},{lat:.{_DECIMALS}f}" for lon, lat in degrees)


def _style(document: ET.Element, name: str, style: Style) -> None:
    element = ET.SubElement(document, _tag("Style"), id=name)
    colour = "ff" + style.colour[5:7] + style.colour[3:5] + style.colour[1:3]
    if style.kind == "marker":
        icon = ET.SubElement(element, _tag("IconStyle"))
        _text(icon, "color", colour)
        _text(icon, "scale", "0.8")
        _text(ET.SubElement(icon, _tag("Icon")), "href", _DOT)
        return
    line = ET.SubElement(element, _tag("LineStyle"))
    _text(line, "color", colour)
    _text(line, "width", "2")
    fill = ET.SubElement(element, _tag("PolyStyle"))
    _text(fill, "color", "66" + colour[2:])
    _text(fill, "fill", "1" if style.kind == "fill" else "0")


def _tag(name: str) -> str:
    return f"{{{_SPACE}}}{name}"


def _text(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, _tag(name)).text = text


def _written(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
