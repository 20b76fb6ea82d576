"""A QGIS project in which all layers of a site are grouped and styled."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from pyproj import CRS

from roadsight.base.arrays import Floats
from roadsight.geometry.crs import code
from roadsight.report.handover.layers import Layer, Linked
from roadsight.report.handover.styles import symbology

_VERSION = "3.34.0"  # QGIS whose project files these are; later ones read them
_TYPES = {"Point": "Point", "LineString": "Line", "Polygon": "Polygon"}
# Renderer of a terrain model: light from the north-west and three more directions
_RELIEF = {
    "type": "hillshade",
    "band": "1",
    "angle": "45",
    "azimuth": "315",
    "zfactor": "1",
    "multidirection": "1",
    "opacity": "0.6",
}
_SHOWN_PLANS = 1  # Plans that are switched on when the project is opened
_MARGIN = 0.05  # Of the extent, around it


def project(
    title: str,
    source: str,
    layers: Sequence[Layer],
    crs: CRS | None,
    bounds: Floats,
    linked: Sequence[Linked] = (),
) -> str:
    """Text of a ``.qgs`` file.

    Parameters
    ----------
    source : name of the GeoPackage beside the project. layers : the topmost first.
    linked : layers in files of their own, below those of their group.
    crs : horizontal CRS of the layers, None for local coordinates.
    bounds : west, south, east, north of what is shown, native coordinates, (4,).
    """
    root = ET.Element("qgis", projectname=title, version=_VERSION)
    ET.SubElement(root, "title").text = title
    spatial = ET.SubElement(root, "projectCrs")
    spatial.append(_reference(crs))
    tree = ET.SubElement(root, "layer-tree-group")
    groups: dict[str, ET.Element] = {}
    # By group, in the order in which groups come first; linked layers at their ends.
    shown: list[Layer | Linked] = [*layers, *linked]
    first = list(dict.fromkeys(layer.group for layer in shown))
    shown.sort(key=lambda layer: first.index(layer.group))
    for layer in shown:
        if layer.group not in groups:
            plans = sum(name.startswith("Plan ") for name in groups)
            is_shown = not layer.group.startswith("Plan ") or plans < _SHOWN_PLANS
            groups[layer.group] = ET.SubElement(
                tree,
                "layer-tree-group",
                name=layer.group,
                checked="Qt::Checked" if is_shown else "Qt::Unchecked",
                expanded="1",
            )
        # Features of a file of its own wait: they would hide those of their group.
        waits = isinstance(layer, Linked) and bool(layer.geometry)
        ET.SubElement(
            groups[layer.group],
            "layer-tree-layer",
            id=_identifier(layer),
            name=layer.name,
            source=_address(source, layer),
            providerKey=_provider(layer),
            checked="Qt::Unchecked" if waits else "Qt::Checked",
            expanded="0",
        )
    root.append(_canvas(crs, bounds))
    listed = ET.SubElement(root, "projectlayers")
    for layer in shown:
        listed.append(_map_layer(source, layer, crs))
    order = ET.SubElement(root, "layerorder")
    for layer in shown:
        ET.SubElement(order, "layer", id=_identifier(layer))
    properties = ET.SubElement(root, "properties")
    paths = ET.SubElement(properties, "Paths")
    ET.SubElement(paths, "Absolute", type="bool").text = "false"
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}\n"


def _provider(layer: Layer | Linked) -> str:
    return "gdal" if isinstance(layer, Linked) and not layer.geometry else "ogr"


def _identifier(layer: Layer | Linked) -> str:
    return "".join(c if c.isalnum() else "_" for c in layer.name)


def _address(source: str, layer: Layer | Linked) -> str:
    if isinstance(layer, Linked):
        return layer.source
    return f"./{source}|layername={layer.name}"


def _reference(crs: CRS | None) -> ET.Element:
    reference = ET.Element("spatialrefsys", nativeFormat="Wkt")
    if crs is not None:
        ET.SubElement(reference, "wkt").text = crs.to_wkt("WKT2_2019")
        if code(crs):
            ET.SubElement(reference, "authid").text = code(crs)
        ET.SubElement(reference, "description").text = crs.name
    return reference


def _canvas(crs: CRS | None, bounds: Floats) -> ET.Element:
    canvas = ET.Element("mapcanvas", name="theMapCanvas")
    unit = "meters"
    if crs is not None and crs.axis_info:
        name = crs.axis_info[0].unit_name.lower()
        if "foot" in name:
            unit = "US survey feet" if "survey" in name else "feet"
        elif "degree" in name:
            unit = "degrees"
    ET.SubElement(canvas, "units").text = unit
    west, south, east, north = (float(value) for value in bounds)
    margin = _MARGIN * max(east - west, north - south)
    extent = ET.SubElement(canvas, "extent")
    for name, value in (
        ("xmin", west - margin),
        ("ymin", south - margin),
        ("xmax", east + margin),
        ("ymax", north + margin),
    ):
        ET.SubElement(extent, name).text = f"{value:.3f}"
    ET.SubElement(canvas, "rotation").text = "0"
    destination = ET.SubElement(canvas, "destinationsrs")
    destination.append(_reference(crs))
    return canvas


def _map_layer(source: str, layer: Layer | Linked, crs: CRS | None) -> ET.Element:
    element = ET.Element("maplayer", autoRefreshEnabled="0", hasScaleBasedVisibilityFlag="0")
    ET.SubElement(element, "id").text = _identifier(layer)
    ET.SubElement(element, "datasource").text = _address(source, layer)
    ET.SubElement(element, "layername").text = layer.name
    ET.SubElement(element, "abstract").text = layer.about
    ET.SubElement(element, "provider", encoding="UTF-8").text = _provider(layer)
    if layer.style is None:
        element.set("type", "raster")
        if layer.is_relief:
            ET.SubElement(ET.SubElement(element, "pipe"), "rasterrenderer", _RELIEF)
        return element
    element.set("type", "vector")
    element.set("geometry", _TYPES[layer.geometry.split(" ")[0]])
    element.set("labelsEnabled", "1" if layer.style.label else "0")
    reference = ET.SubElement(element, "srs")
    reference.append(_reference(crs))
    element.extend(symbology(layer.style))
    return element
