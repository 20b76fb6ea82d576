"""A drawing for CAD (DXF): layers, blocks with attributes, and texts."""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from typing import Any

import ezdxf
import numpy as np
import pandas as pd
import shapely
from ezdxf import units
from ezdxf.document import Drawing
from ezdxf.enums import TextEntityAlignment
from ezdxf.layouts import BlockLayout, Modelspace

from roadsight.geometry.frames import Frame
from roadsight.report.handover.layers import Layer, field_text

logging.getLogger("ezdxf").setLevel(logging.WARNING)

_VERSION = "R2010"  # Release of the format that every CAD of the last ten years reads
_TEXT_M = 0.8  # Height of texts: 1.6 mm on a plan of 1:500
_MARK_M = 0.5  # Radius of the marks of sensors and poles
# Codes of drawing units; 21 is the US survey foot
_UNITS = {"metre": units.M, "foot": units.FT, "us-survey-foot": 21}
# Characters that names of layers in a drawing must not have
_FORBIDDEN = str.maketrans(dict.fromkeys('<>/\\":;?*|=`', "_"))


def drawing(layers: Sequence[Layer], frame: Frame, unit: str) -> str:
    """Text of a ``.dxf`` file in native coordinates; the same layers give the same text.

    Sensors and poles are blocks with their fields as attributes; sensors are turned to where they
    face. Heights are native.

    Parameters
    ----------
    unit : name of the native unit, as frame.json has it.
    """
    fixed = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        document = ezdxf.new(_VERSION, setup=True)
        document.units = _UNITS.get(unit, units.M)
        scale = 1.0 / frame.unit_m
        for layer in layers:
            _add(document, layer, frame, scale)
        # The library adds these when it writes, in the order of a set.
        for kind in sorted(document.entitydb.dxf_types_in_use()):
            document.classes.add_class(kind)
        stream = io.StringIO()
        document.write(stream)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed
    return stream.getvalue()


def _add(document: Drawing, layer: Layer, frame: Frame, scale: float) -> None:
    name = layer.name.translate(_FORBIDDEN).upper()
    document.layers.add(name, true_color=int(layer.style.colour[1:], 16))
    space = document.modelspace()
    geometry = layer.features.geometry.name
    records = layer.features.drop(columns=geometry).to_dict("records")
    block = _block(document, layer, scale) if layer.style.label else ""
    for record, shape in zip(records, layer.features.geometry, strict=True):
        for part in shapely.get_parts(shape):
            if part.geom_type == "Point":
                _point(space, name, block, record, _native(part, frame)[0], layer, scale)
            elif part.geom_type == "LineString":
                space.add_polyline3d(_native(part, frame), dxfattribs={"layer": name})
            elif part.geom_type == "Polygon":
                for ring in (part.exterior, *part.interiors):
                    space.add_polyline3d(_native(ring, frame), dxfattribs={"layer": name})


def _point(
    space: Modelspace,
    name: str,
    block: str,
    record: dict[str, Any],
    place: tuple[float, ...],
    layer: Layer,
    scale: float,
) -> None:
    if not block:
        space.add_point(place, dxfattribs={"layer": name})
        return
    turned = record.get("yaw_deg", 0.0)
    rotation = float(turned) if pd.notna(turned) else 0.0
    inserted = space.add_blockref(block, place, dxfattribs={"layer": name, "rotation": rotation})
    inserted.add_auto_attribs({key.upper(): field_text(value) for key, value in record.items()})
    text = space.add_text(
        str(record[layer.style.label]), height=_TEXT_M * scale, dxfattribs={"layer": name}
    )
    beside = _MARK_M * 1.6 * scale
    text.set_placement(
        (place[0] + beside, place[1] + beside, place[2]), align=TextEntityAlignment.BOTTOM_LEFT
    )


def _block(document: Drawing, layer: Layer, scale: float) -> str:
    """A round mark, with an arrow along x where features have a direction, and hidden fields."""
    name = layer.name.translate(_FORBIDDEN).upper()
    block: BlockLayout = document.blocks.new(name)
    radius = _MARK_M * scale
    block.add_circle((0, 0), radius)
    if "yaw_deg" in layer.features:
        block.add_line((0, 0), (3 * radius, 0))
        block.add_lwpolyline(
            [(2.5 * radius, 0.3 * radius), (3 * radius, 0), (2.5 * radius, -0.3 * radius)]
        )
    fields = [key for key in layer.features.columns if key != layer.features.geometry.name]
    for number, key in enumerate(fields):
        block.add_attdef(
            key.upper(),
            (0, -(number + 2) * radius),
            dxfattribs={"height": radius * 0.8, "flags": 1},
        )
    return name


def _native(shape: Any, frame: Frame) -> list[tuple[float, ...]]:
    places = shapely.get_coordinates(shape, include_z=bool(shapely.has_z(shape)))
    native = frame.to_native(places)
    if native.shape[1] == 2:
        native = np.column_stack([native, np.full(len(native), frame.origin[2])])
    return [tuple(float(value) for value in row) for row in native]
