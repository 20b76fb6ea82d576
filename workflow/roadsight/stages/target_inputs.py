"""Targets as detection stages take them: their feet, and what stands on these."""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.errors import InputError
from roadsight.io.tables import read_table
from roadsight.placement.shapes import Box, Cylinder, Shape


def add_shape_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that say what a target is."""
    parser.add_argument("--radius-m", type=float, default=0.25)
    parser.add_argument("--height-m", type=float, default=0.6)
    parser.add_argument("--box", type=float, nargs=3, help="length, width, height instead, m")


def read_shaped_targets(
    arguments: argparse.Namespace,
) -> tuple[pd.DataFrame, NDArray[np.float64], Shape]:
    """Targets, their feet and their shape; feet of boxes have headings, (n, 4).

    Raises
    ------
    InputError : boxes without headings.
    """
    targets = read_table(arguments.targets)
    names = ["x", "y", "z"]
    if not arguments.box:
        feet_m = targets[names].to_numpy(np.float64)
        return targets, feet_m, Cylinder(arguments.radius_m, arguments.height_m)
    if "heading_rad" not in targets:
        raise InputError(
            "has no headings of targets that are boxes",
            where=arguments.targets,
            hint="run the workflow again",
        )
    feet_m = targets[[*names, "heading_rad"]].to_numpy(np.float64)
    return targets, feet_m, Box(*arguments.box)


def said_of_shape(arguments: argparse.Namespace, shape: Shape) -> dict[str, float]:
    """What a table of detections says of its targets."""
    about = {"height_m": shape.height_m, "min_beams": arguments.min_beams}
    if isinstance(shape, Box):
        return about | {"length_m": shape.length_m, "width_m": shape.width_m}
    return {"radius_m": shape.radius_m} | about
