"""A street of 48 m and the whole placement job on it, stage by stage in this process."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import laspy
import numpy as np
import pandas as pd

from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from tests.properties.stage_calls import StageCalls

SENSORS = str(Path(__file__).resolve().parents[2] / "config/sensors.yaml")
SENSOR = "OS-32"


@dataclass(frozen=True)
class Street:
    """Native coordinates of a scene's points and road edges, with what a file says of them.

    Parameters
    ----------
    xyz : (n, 3); intensity : (n,). edges : native x, y of each edge's vertices.
    units : as the stage takes them. scale : of the LAS file's whole numbers.
    """

    xyz: np.ndarray
    intensity: np.ndarray
    edges: dict[str, np.ndarray]
    units: str = "metre"
    scale: float = 0.001

    def moved(self, matrix, shift=(0.0, 0.0)) -> Street:
        """The street in another place: plan coordinates times a matrix (2, 2), then moved."""
        move = np.asarray(matrix, float)
        xy = self.xyz[:, :2] @ move.T + shift
        edges = {name: line @ move.T + shift for name, line in self.edges.items()}
        return replace(self, xyz=np.column_stack([xy, self.xyz[:, 2]]), edges=edges)

    def rows(self, chosen) -> Street:
        """The street with some of its points, in that order."""
        return replace(self, xyz=self.xyz[chosen], intensity=self.intensity[chosen])


def make_street(seed=1) -> Street:
    """Smooth dark road between rough bright verges, trunks, a parked van and a wall."""
    rng = np.random.default_rng(seed)

    def patch(x, y, per_m2):
        count = int(per_m2 * np.ptp(x) * np.ptp(y))
        return rng.uniform(*x, count), rng.uniform(*y, count)

    x, y = patch((0, 48), (-4, 4), 120)
    road = np.column_stack([x, y, 0.01 * x + rng.normal(0, 0.003, len(x))])
    verges = []
    for side in (-1, 1):
        x, y = patch((0, 48), (4, 13), 70)
        z = 0.01 * x - 0.06 * (y - 4) + rng.normal(0, 0.05, len(x))
        verges.append(np.column_stack([x, side * y, z]))
    verges.append(_upright(rng, 48, 3.0) * [1, 0, 1] + [0, 13.0, -0.3])
    for place in ((7, 7), (19, -7), (31, 7.5), (42, -6.5)):
        turn, z = rng.uniform(0, 2 * np.pi, 1500), rng.uniform(-0.3, 6, 1500)
        verges.append(
            np.column_stack([place[0] + 0.2 * np.cos(turn), place[1] + 0.2 * np.sin(turn), z])
        )
    van = _upright(rng, 5, 2.2) * [1, 0, 1] + [24, -2.2, 0.24]
    rest = np.concatenate([*verges, van])
    xyz = np.round(np.concatenate([road, rest]), 3)
    tone = np.concatenate([rng.normal(60, 8, len(road)), rng.normal(170, 20, len(rest))])
    line = np.linspace(2, 46, 5)
    edges = {"north": np.column_stack([line, 0 * line + 5]),
             "south": np.column_stack([line, 0 * line - 5])}  # fmt: skip
    return Street(xyz, np.clip(tone, 1, 255).astype(np.uint16), edges)


def _upright(rng, length_m, height_m):
    """Points of a wall along x."""
    count = int(60 * length_m * height_m)
    return np.column_stack(
        [rng.uniform(0, length_m, count), np.zeros(count), rng.uniform(0, height_m, count)]
    )


class PlacementJob(StageCalls):
    """Runs the job in a folder; results are read from there.

    Parameters
    ----------
    folder : empty. tile_size_m : of the tiled cloud. shards : of depth maps and detections.
    """

    def __init__(self, folder: Path, tile_size_m: float = 64.0, shards: int = 1) -> None:
        super().__init__(folder)
        self.tile_size_m, self.shards = tile_size_m, shards

    def run(self, street: Street) -> PlacementJob:
        """All stages from the cloud to the proven cover of one plan."""
        self._write(street)
        self._scene(street)
        self._placement()
        return self

    def _write(self, street: Street) -> None:
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales, header.offsets = np.full(3, street.scale), np.floor(street.xyz.min(axis=0))
        cloud = laspy.LasData(header)
        cloud.x, cloud.y, cloud.z = street.xyz.T
        cloud.intensity, cloud.classification = street.intensity, np.ones(len(street.xyz), np.uint8)
        cloud.return_number = cloud.number_of_returns = np.ones(len(street.xyz), np.uint8)
        cloud.write(self.path("cloud.laz"))
        rows = [(name, *vertex) for name, line in street.edges.items() for vertex in line]
        pd.DataFrame(rows, columns=["edge", "x", "y"]).to_csv(self.path("edges.csv"), index=False)

    def _scene(self, street: Street) -> None:
        site = ("--site", "street")
        units = ("--crs", "local", "--units", street.units, "--vertical-units", street.units)
        self._stage("ingest_cloud", *site, *units, "--tile-size-m", str(self.tile_size_m),
                    clouds="cloud.laz", cloud="cloud", frame="frame")  # fmt: skip
        both = {"cloud": "cloud", "frame": "frame"}
        self._stage("profile_scene", **both, out="profile")
        self._stage("build_dem", *site, **both, profile="profile", dem="dem.tif", ground="ground")
        self._stage("cluster_fpfh", cloud="cloud", ground="ground", profile="profile",
                    out="clusters")  # fmt: skip
        self._stage("extract_pavement", *site, **both, ground="ground", clusters="clusters",
                    profile="profile", pavement="pavement.gpkg", points="points")  # fmt: skip
        self._stage("build_edges", *site, frame="frame", pavement="pavement.gpkg",
                    dem="dem.tif", digitised="edges.csv", out="edges.gpkg")  # fmt: skip
        self._stage("build_surfels", cloud="cloud", out="surfels")

    def _placement(self) -> None:
        site, sensor = ("--site", "street"), ("--sensor", SENSOR, "--sensors", SENSORS)
        spacing = ("--spacing-m", "11", "--height-step-m", "3")
        self._stage("place_candidates", *site, *spacing, edges="edges.gpkg",
                    pavement="pavement.gpkg", dem="dem.tif", cloud="cloud", frame="frame",
                    doubts="placed", out="candidates")  # fmt: skip
        self._stage("place_targets", "--width-m", "0.5", pavement="points",
                    outline="pavement.gpkg", frame="frame", out="targets")  # fmt: skip
        for shard in reversed(range(self.shards)):
            part = ("--shard", str(shard), "--shards", str(self.shards))
            self._stage("render_depth_maps", *sensor, *part, candidates="candidates",
                        surfels="surfels", cloud="cloud", out=f"depth{shard}")  # fmt: skip
            self._stage("build_detection_shard", *sensor, depth=f"depth{shard}",
                        candidates="candidates", targets="targets", out=f"seen{shard}")  # fmt: skip
        seen = ("--detections", *(self.path(f"seen{shard}") for shard in range(self.shards)))
        self._stage("check_coverage", *seen, "--plans", f"one={SENSOR}", targets="targets",
                    candidates="candidates", out="coverage")  # fmt: skip
        self._stage("solve_cover", *site, *seen, "--plan", "one", "--sensors", f"{SENSOR}=1",
                    "--uncoverable", "exclude", "--second-objective", "False",
                    coverage="coverage", targets="targets",
                    candidates="candidates", frame="frame", solution="solution",
                    layers="layers.gpkg", timing="timing")  # fmt: skip

    @property
    def solution(self) -> dict:
        """Content of the solution."""
        return read_json(self.path("solution"))

    @property
    def chosen(self) -> list[str]:
        """Names of the chosen candidates."""
        return sorted(sensor["candidate"] for sensor in self.solution["sensors"])

    @property
    def places_m(self) -> pd.DataFrame:
        """Local x, y, z of all candidates by name."""
        return read_table(self.path("candidates")).set_index("candidate")[["x", "y", "z"]]
