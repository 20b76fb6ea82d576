"""Styles of layers in the language of QGIS (QML)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree as ET

_VERSION = "3.34.0"  # QGIS whose style language this is; later ones read it
_OUTLINE = "#ffffff"
# Colours of targets by how many sensors see them
SEEN = {
    "by none": "#dc2626",
    "by one": "#93c5fd",
    "by two": "#3b82f6",
    "by three or more": "#1e3a8a",
}


@dataclass(frozen=True)
class Category:
    """Features with one value. value : as text. label : in the legend. colour : as #rrggbb."""

    value: str
    label: str
    colour: str


@dataclass(frozen=True)
class Style:
    """How a layer is drawn.

    Parameters
    ----------
    kind : marker, line or fill. colour : as #rrggbb. size_mm : diameter or width on the screen.
    label : field that is written beside features, or empty.
    by, categories : expression and its values with colours of their own.
    pattern : of a fill, as QGIS names it. opacity : of a fill, 0 to 1; its outline is opaque.
    """

    kind: Literal["marker", "line", "fill"]
    colour: str
    size_mm: float = 1.0
    label: str = ""
    by: str = ""
    categories: Sequence[Category] = ()
    pattern: Literal["solid", "b_diagonal"] = "solid"
    opacity: float = 1.0


def qml(style: Style) -> str:
    """Style as a QML document."""
    root = ET.Element("qgis", version=_VERSION, styleCategories="Symbology|Labeling")
    root.set("labelsEnabled", "1" if style.label else "0")
    root.extend(symbology(style))
    return ET.tostring(root, encoding="unicode")


def symbology(style: Style) -> list[ET.Element]:
    """Renderer, and labels where there are any, as elements of a style or of a project's layer."""
    kind = "categorizedSymbol" if style.categories else "singleSymbol"
    renderer = ET.Element("renderer-v2", type=kind, symbollevels="0", enableorderby="0")
    colours = [style.colour]
    if style.categories:
        renderer.set("attr", style.by)
        listed = ET.SubElement(renderer, "categories")
        for number, category in enumerate(style.categories):
            ET.SubElement(
                listed,
                "category",
                symbol=str(number),
                value=category.value,
                label=category.label,
                render="true",
                type="string",
            )
        colours = [category.colour for category in style.categories]
    symbols = ET.SubElement(renderer, "symbols")
    for number, colour in enumerate(colours):
        symbol = ET.Element(
            "symbol", name=str(number), type=style.kind, alpha="1", clip_to_extent="1"
        )
        classes = {"marker": "SimpleMarker", "line": "SimpleLine", "fill": "SimpleFill"}
        layer = ET.SubElement(symbol, "layer", enabled="1", locked="0")
        layer.set("class", classes[style.kind])
        layer.set("pass", "0")
        options = ET.SubElement(layer, "Option", type="Map")
        for key, value in _properties(style, colour).items():
            ET.SubElement(options, "Option", type="QString", name=key, value=value)
        symbols.append(symbol)
    return [renderer, *([_labels(style.label)] if style.label else [])]


def _properties(style: Style, colour: str) -> dict[str, str]:
    size = f"{style.size_mm:g}"
    if style.kind == "marker":
        return {
            "name": "circle",
            "color": _rgba(colour),
            "outline_color": _rgba(_OUTLINE),
            "outline_width": "0.2",
            "size": size,
            "size_unit": "MM",
        }
    if style.kind == "line":
        return {"line_color": _rgba(colour), "line_width": size, "line_width_unit": "MM"}
    return {
        "color": _rgba(colour, style.opacity),
        "outline_color": _rgba(colour),
        "outline_width": size,
        "outline_width_unit": "MM",
        "style": style.pattern,
    }


def _labels(field: str) -> ET.Element:
    labeling = ET.Element("labeling", type="simple")
    settings = ET.SubElement(labeling, "settings")
    text = ET.SubElement(settings, "text-style", fieldName=field, fontSize="8", isExpression="0")
    text.set("textColor", _rgba("#0f172a"))
    ET.SubElement(
        text,
        "text-buffer",
        bufferDraw="1",
        bufferSize="0.8",
        bufferSizeUnits="MM",
        bufferColor=_rgba("#ffffff"),
    )
    return labeling


def _rgba(colour: str, opacity: float = 1.0) -> str:
    """Red, green, blue and opacity, as QGIS writes them."""
    return ",".join(str(int(colour[k : k + 2], 16)) for k in (1, 3, 5)) + f",{255 * opacity:.0f}"
