"""Found poles against known ones."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Bools, Floats
from roadsight.base.sections.poles import SightingRules, Validation
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table
from roadsight.io.vector.known import read_points
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_layer
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.risk.scenarios import CELL_M, ScenarioSettings, classify_places, find_branches
from roadsight.poles.risk.validation import (
    NEAR_EDGE_M,
    THRESHOLDS_M,
    RoadEdges,
    cautions,
    describe,
    describe_scenarios,
    geodesic_m,
    match_points,
    score_lines,
    score_near,
    score_thresholds,
    split_errors,
    within_reach,
)
from roadsight.poles.triangulate.cloud_objects import BESIDE_M
from roadsight.stages.command import Command

log = logging.getLogger("validate_poles")

_NAMES = {
    "straight": "straight road",
    "curved": "curved road",
    "intersection": "intersection",
    "extraneous": "extraneous features",
}
"""Scenarios as the report names them."""

_PAVED = (11, 17)
"""Classes of road surface and of bridge decks among voxels."""
_DRIVEN_M = 15.0
"""Edges of the road that was driven lie this near to its cameras: it has up to four lanes."""


def validate_poles(
    poles_path: Path,
    truth_path: str,
    frame_path: Path,
    frames_path: Path,
    edges: Path,
    reach_m: Annotated[float, Validation],
    match_m: Annotated[float, Validation],
    kinds: Annotated[Sequence[str], SightingRules],
    truth_kind: Annotated[str | None, "only those whose `kind` is this"] = None,
    truth_crs: Annotated[str | None, "CRS of a vector file that names none"] = None,
    voxels: Annotated[Path | None, "to find side roads, driveways, car parks"] = None,
    placed: Annotated[Path | None, "layers of the objects, with guardrails"] = None,
    roadside: Annotated[Path | None, "GeoPackage of known trees, guardrails, driveways"] = None,
    *,
    out: Path,
) -> None:
    """Write errors, scores by threshold and errors by scenario.

    They are of poles, or of the kind of object that the known ones are said to be; the scores of
    each other kind that was looked for stand beside them.
    """
    frame = Frame.from_dict(read_json(frame_path))
    poles = read_table(poles_path)
    objects = poles[poles["kept"].to_numpy(bool)].reset_index(drop=True)
    of_kind = truth_kind if truth_kind in KINDS else "pole"
    poles = objects[objects["kind"] == of_kind].reset_index(drop=True)
    frames = read_table(frames_path, ["route", "sequence", "x", "y"])
    truth = read_points(truth_path, frame, truth_crs)
    places = truth[["x", "y"]].to_numpy(np.float64)
    tell_near(log, "known poles", places, read_json(frame_path), truth_path)
    signs = truth[truth["kind"] == "sign"] if "kind" in truth else truth[:0]
    if truth_kind:
        truth = truth[truth["kind"] == truth_kind].reset_index(drop=True)
    elif "kind" in truth:
        truth = truth[~truth["kind"].isin(set(KINDS) - {"pole"})].reset_index(drop=True)
    cameras_m = frames[["x", "y"]].dropna().to_numpy(np.float64)
    near = within_reach(_xy(truth), cameras_m, reach_m)
    known = truth[near].reset_index(drop=True)
    matches = match_points(_xy(poles), _xy(known), match_m)
    errors = _errors(
        edges, voxels, roadside, frame, frames, poles.iloc[matches[:, 0]], known.iloc[matches[:, 1]]
    )
    warnings = cautions(len(known), int((~near).sum()))
    for warning in warnings:
        log.warning("%s", warning)
    content = _content(errors, warnings)
    content["truth"] = {
        "within_reach": len(known),
        "out_of_reach": int((~near).sum()),
        "reach_m": reach_m,
    }
    content["poles"], content["match_m"] = len(poles), match_m
    content["thresholds"] = score_thresholds(_xy(poles), _xy(known), THRESHOLDS_M)
    edges_m = read_table(edges, ["x", "y"]).to_numpy(np.float64)
    near_cameras = _Near(cameras_m, reach_m, edges_m, RouteTracks(frames))
    found = _other_kinds(objects, signs, placed, roadside, frame, near_cameras)
    content["kinds"] = {kind: scores for kind, scores in found.items() if kind in kinds}
    write_json(out, _plain(content))


@dataclass(frozen=True)
class _Near:
    """Which places count: within reach of a camera, and of those the ones near the road's edge.

    Edges further than `_DRIVEN_M` from every camera are of other roads.
    """

    cameras_m: Floats
    reach_m: float
    edges_m: Floats
    tracks: RouteTracks

    def camera(self, places_m: Floats) -> Bools:
        return within_reach(places_m, self.cameras_m, self.reach_m)

    def road(self, places_m: Floats) -> Bools:
        return np.asarray(self.tracks.away_m(places_m) <= BESIDE_M)

    def edge(self, places_m: Floats) -> Bools:
        driven = self.edges_m[within_reach(self.edges_m, self.cameras_m, _DRIVEN_M)]
        return self.camera(places_m) & within_reach(places_m, driven, NEAR_EDGE_M)

    def nearest(self, outlines: Sequence[shapely.Geometry]) -> Floats:
        """Of each outline the place (n, 2) that is nearest to a track."""
        places = [shapely.get_coordinates(shapely.segmentize(one, 0.2))[:, :2] for one in outlines]
        nearest = [one[int(np.argmin(self.tracks.away_m(one)))] for one in places]
        return np.array(nearest, np.float64).reshape(-1, 2)

    def parts(self, lines: Sequence[shapely.Geometry]) -> list[Floats]:
        """Parts of lines, places (n, 2) each, that lie within reach of a camera."""
        around = shapely.union_all(shapely.buffer(shapely.points(self.cameras_m), self.reach_m))
        inside = shapely.get_parts(shapely.intersection(list(lines), around))
        return [shapely.get_coordinates(one) for one in inside if one.length > 0]


def _other_kinds(
    objects: pd.DataFrame,
    signs: pd.DataFrame,
    placed: Path | None,
    roadside: Path | None,
    frame: Frame,
    near: _Near,
) -> dict[str, dict[str, float | int | None]]:
    """Scores of signs, trees, buildings and guardrails, of which any are known."""
    found = {}
    if len(signs):
        ours, theirs = _xy(objects[objects["kind"] == "sign"]), _xy(signs)
        found["sign"] = score_near(ours, theirs, near.camera(ours), near.camera(theirs))
    if roadside and placed:
        ours = _xy(objects[objects["kind"] == "tree"])
        theirs = shapely.get_coordinates(read_layer(roadside, "trees", frame).geometry)
        found["tree"] = score_near(ours, theirs, near.edge(ours), near.edge(theirs))
        ours = _xy(objects[objects["kind"] == "building"])
        outlines = read_layer(roadside, "buildings", frame).geometry
        theirs = _nearest_to(ours, outlines) if len(ours) else near.nearest(outlines)
        counts = near.road(ours), near.road(near.nearest(outlines))
        found["building"] = score_near(ours, theirs, *counts)
        rails = read_layer(placed, "guardrails", frame)
        kept = rails[rails["kept"].to_numpy(bool)] if len(rails) else rails
        known = read_layer(roadside, "guardrails", frame)
        rails_m = [shapely.get_coordinates(one) for one in kept.geometry]
        found["guardrail"] = score_lines(rails_m, near.parts(known.geometry))
    return found


def _nearest_to(places_m: Floats, outlines: Sequence[shapely.Geometry]) -> Floats:
    """Of each outline the place (n, 2) that is nearest to any of some places.

    Two corners of a wall along the road may be as near to it: where on its outline a building was
    placed does not matter.
    """
    at = shapely.multipoints(places_m)
    lines = [shapely.shortest_line(one.exterior, at) for one in outlines]
    return np.array([line.coords[0][:2] for line in lines], np.float64).reshape(-1, 2)


def _errors(
    edges_path: Path,
    voxels: Path | None,
    roadside: Path | None,
    frame: Frame,
    frames: pd.DataFrame,
    found: pd.DataFrame,
    known: pd.DataFrame,
) -> pd.DataFrame:
    """One row for each match: distances, their parts and the scenario."""
    found_m, known_m = _xy(found), _xy(known)
    table = pd.DataFrame({"pole": found["id"].to_numpy(), "truth": known["id"].to_numpy()})
    if frame.crs_wkt is None or table.empty:  # in plan
        table["geodesic_m"] = np.hypot(*(found_m - known_m).T)
    else:
        to_geographic = SiteNorth(frame).to_geographic
        table["geodesic_m"] = geodesic_m(*to_geographic(found_m), *to_geographic(known_m))
    for name in ("across_m", "along_m", "offset_m", "known_offset_m"):
        table[name] = np.nan
    edges_m = read_table(edges_path, ["x", "y"]).to_numpy(np.float64)
    if len(edges_m) and len(table):
        edges = RoadEdges(edges_m)
        across, along = split_errors(found_m - known_m, edges.normals(known_m))
        table["across_m"], table["along_m"] = across, along
        table["offset_m"] = edges.offset_m(found_m)[0]
        table["known_offset_m"] = edges.offset_m(known_m)[0]
    tracks = RouteTracks(frames)
    paved = _paved(voxels) if voxels else None
    branches = None if paved is None else find_branches(tracks, paved, edges_m)
    if branches is not None and roadside is not None:
        branches = branches.with_outlines(read_layer(roadside, "driveways", frame).geometry)
    scenarios = classify_places(known_m, tracks, branches, ScenarioSettings())
    return pd.concat([table, scenarios], axis=1)


def _paved(path: Path) -> Floats | None:
    """Middles (n, 2) of the columns of voxels that hold road or a bridge deck.

    None where voxels are too wide to tell a driveway.
    """
    about = read_about(path)
    cell_m = float(about["cell_size_m"])
    if cell_m > CELL_M:
        log.warning("voxels of %g m do not tell driveways, those up to %g m do", cell_m, CELL_M)
        return None
    table = read_table(path, ["ix", "iy", "cls"])
    index = table.loc[table["cls"].isin(_PAVED), ["ix", "iy"]].drop_duplicates()
    anchor = np.asarray(about["anchor"], np.float64)[:2]
    return np.asarray(anchor + (index.to_numpy(np.float64) + 0.5) * cell_m)


def _content(errors: pd.DataFrame, warnings: list[str]) -> dict[str, Any]:
    geodesic = errors["geodesic_m"].to_numpy(np.float64)
    summary = describe(geodesic)
    rows = errors.drop(columns=list(_NAMES)).to_dict("records")
    for row, (_, error) in zip(rows, errors.iterrows(), strict=True):
        row["scenarios"] = [
            text for name, text in _NAMES.items() if error[name] is True or error[name] is np.True_
        ]
    return {
        "warnings": warnings,
        "mean_m": summary["mean"],
        "geodesic_m": summary,
        "across_m": describe(errors["across_m"].to_numpy(np.float64)),
        "along_m": describe(errors["along_m"].to_numpy(np.float64)),
        "scenarios": describe_scenarios(geodesic, errors),
        "errors": sorted(rows, key=lambda row: (row["geodesic_m"], row["pole"])),
    }


def _xy(table: pd.DataFrame) -> Floats:
    return table[["x", "y"]].to_numpy(np.float64)


def _plain(content: Any) -> Any:
    """JSON content with None for what is no finite number."""
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_plain(value) for value in content]
    if isinstance(content, float | np.floating):
        return float(content) if math.isfinite(content) else None
    return content.item() if isinstance(content, np.generic) else content


main = Command(validate_poles)


if __name__ == "__main__":
    sys.exit(main())
