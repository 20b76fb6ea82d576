"""What calibration and alignment read: frames, image edges, road edges, terrain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Reach
from roadsight.geometry.frames import Frame
from roadsight.io.images.intrinsics import read_intrinsics
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.scene_tables import read_terrain
from roadsight.io.records.tables import read_about, read_table
from roadsight.placement.sensors.light import rise_m
from roadsight.poles.alignment.dense import GivenLens
from roadsight.poles.alignment.drive import (
    Place,
    Visible,
    image_edges_of,
    loader,
    near_edges,
    places_of,
    sight_of,
)
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.roadside import NearEdges, RoadEdges
from roadsight.poles.alignment.solve import ImageEdges, Noise
from roadsight.poles.calibration.calibration import Loader
from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.scene.terrain.tin import TerrainSight

_FRAME = ["image", "route", "sequence", "x", "y", "z_road", "heading_deg", "width_px", "height_px"]
"""Columns of the frames that are read."""
_AXIS = [
    "image",
    "view",
    "u",
    "v",
    "slope",
    "v_foot",
    "v_top",
    "width_px",
    "width_view_px",
    "height_view_px",
    "foot_visible",
    "top_cut",
]
"""Columns of the pole axes that are read."""
_FEWEST_POINTS = 4
"""Returns that must agree on the place of a column that cameras are steered by."""
_MOST_SIGMA_M = 0.15
"""Standard deviation of such a place at most: at 30 m it is 0.3 degrees."""
_MOST_SIGMA_OF_STEM_M = 0.3
"""The same for stems of a scanner on a vehicle, whose returns are smeared."""
_EDGE = ["image", "u", "v", "side", "kind"]
"""Columns of the image edges that are read."""


@dataclass(frozen=True)
class AlignmentScene:
    """Images of all routes with what is needed to align them."""

    places: list[Place]
    edges: RoadEdges
    pixels: dict[str, pd.DataFrame]
    reach: Reach
    noise: Noise
    visible: Visible | None
    axes: dict[str, pd.DataFrame]
    columns: PoleColumns
    landmarks: LandmarkNoise
    curved: bool = False
    lenses: Mapping[str, GivenLens] = field(default_factory=dict)

    def edges_of(self, place: Place) -> tuple[ImageEdges, NearEdges]:
        """Road edges in one image, and those of the cloud that it may show."""
        empty = pd.DataFrame({name: [] for name in _EDGE})
        image_edges = image_edges_of(self.pixels.get(place.image, empty), self.reach)
        map_edges = near_edges(place, self.edges, self.reach, self.visible)
        return image_edges, lowered(map_edges, place) if self.curved else map_edges

    def load(self, place: Place) -> Loader:
        """Maker of the task of one image."""
        image_edges, map_edges = self.edges_of(place)
        rows = self.axes.get(place.image)
        sight = None if rows is None else sight_of(place, rows, self.columns, self.landmarks)
        return loader(place, image_edges, map_edges, self.noise, sight)

    def loaders(self) -> Iterator[tuple[Place, Loader]]:
        """Each place with the maker of its task."""
        for place in self.places:
            yield place, self.load(place)


def lowered(map_edges: NearEdges, place: Place) -> NearEdges:
    """Road edges as low as a place sees them over the curved Earth through refracting air."""
    away_m = np.hypot(*(map_edges.xyz_m[:, :2] - [place.start.x_m, place.start.y_m]).T)
    drop_m = np.column_stack([np.zeros((len(away_m), 2)), rise_m(away_m)])
    return replace(map_edges, xyz_m=map_edges.xyz_m - drop_m)


@dataclass(frozen=True)
class SceneFiles:
    """What the stages that place cameras are run on."""

    frames: Path
    road_edges: Path
    frame: Path
    image_edges: Annotated[Sequence[Path], "tables of edge pixels"]
    reach: Reach
    terrain: Annotated[Path | None, "triangles that may hide road"] = None
    dem: Annotated[Path | None, "ground heights, better than the edges' own"] = None
    curvature: Literal["simulate", "skip"] = "skip"
    pole_axes: Annotated[Sequence[Path], "tables of pole axes"] = ()
    columns: Annotated[Path | None, "pole-like columns of the cloud"] = None


def read_scene(given: SceneFiles, lens: str | None = None) -> AlignmentScene:
    """Read the inputs that these stages share; ``lens`` as `read_intrinsics` takes it.

    Raises
    ------
    InputError : a file cannot be read, or no image may be used.
    """
    frames = read_table(given.frames, [*_FRAME, "status"])
    frames = frames[(frames["status"] == "ok") & np.isfinite(frames["z_road"])]
    if frames.empty:
        raise InputError(
            "has no image that may be used",
            where=str(given.frames),
            hint="see its column `status` for the reasons",
        )
    edges = _road_edges(given)
    places = places_of(frames.reset_index(drop=True), edges, given.reach)
    lenses = known_lenses(lens, places)
    return AlignmentScene(
        [with_centre(place, lenses) for place in places],
        edges,
        _by_image(given.image_edges, _EDGE),
        given.reach,
        Noise.of_spacing(read_about(given.road_edges).get("spacing_m", 0.0)),
        TerrainSight(read_terrain(given.terrain)).visible if given.terrain else None,
        _by_image(given.pole_axes, _AXIS),
        _landmark_columns(given.columns),
        LandmarkNoise(),
        given.curvature == "simulate",
        lenses,
    )


def known_lenses(source: str | None, places: list[Place]) -> dict[str, GivenLens]:
    """Lens of each image where the site gives them; none without a source.

    Raises
    ------
    InputError : as `read_intrinsics`.
    """
    if not source:
        return {}
    sizes = [(p.image, p.start.width_px, p.start.height_px) for p in places]
    return read_intrinsics(source, sizes)


def with_centre(place: Place, lenses: Mapping[str, GivenLens]) -> Place:
    """The same place with the known principal point of its image."""
    if place.image not in lenses:
        return place
    lens = lenses[place.image]
    return replace(place, start=replace(place.start, cx_px=lens.cx_px, cy_px=lens.cy_px))


def _by_image(paths: Sequence[Path], columns: list[str]) -> dict[str, pd.DataFrame]:
    """Rows of all tables by image."""
    if not paths:
        return {}
    table = pd.concat([read_table(path, columns) for path in paths])
    return {str(image): part for image, part in table.groupby("image", sort=True)}


def _landmark_columns(path: Path | None) -> PoleColumns:
    """Columns that are good enough to steer by."""
    columns = read_columns(path)
    most_m = np.where(columns.open_top > 0, _MOST_SIGMA_OF_STEM_M, _MOST_SIGMA_M)
    good = (columns.points >= _FEWEST_POINTS) & (columns.sigma_m <= most_m)
    return PoleColumns(*(getattr(columns, f.name)[good] for f in fields(columns)))


def read_columns(path: Path | None) -> PoleColumns:
    """Pole-like columns of a table; none without a path."""
    names = ["x", "y", "top_m", "sigma_m", "z_ground", "points", "open_top"]
    table = read_table(path, names) if path else pd.DataFrame(columns=names, dtype=np.float64)
    x, y, *rest = (np.ascontiguousarray(table[name].to_numpy(np.float64)) for name in names)
    return PoleColumns(np.column_stack([x, y]), *rest)


def _road_edges(given: SceneFiles) -> RoadEdges:
    xyz = read_table(given.road_edges, ["x", "y", "z"]).to_numpy(np.float64, copy=True)
    if given.dem:
        frame = Frame.from_dict(read_json(given.frame))
        height = read_raster(given.dem, frame).sample(xyz[:, 0], xyz[:, 1])
        # A bridge stands above the ground: its own heights are the better ones.
        near = np.isfinite(height) & (np.abs(height - xyz[:, 2]) < 1.0)
        xyz[near, 2] = height[near]
    return RoadEdges.from_points(xyz)
