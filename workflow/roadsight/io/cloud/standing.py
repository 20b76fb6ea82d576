"""A tiled cloud without what only passed through the scene."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from roadsight.base.arrays import Bools, Floats32
from roadsight.base.errors import InputError
from roadsight.io.cloud.tiles import POSITION, Bounds, CloudTiles, stack_xyz
from roadsight.io.records.tables import read_table


class StandingCloud:
    """Positions of the points that stand in the scene, tile by tile.

    Parameters
    ----------
    cloud : path of the tiled cloud.
    traffic : path of the traffic mask, or None where traffic was not cleared.
    without : classes whose points are left out, too.

    Raises
    ------
    InputError : a file is missing or damaged, the two do not belong together, or no point is of
        the classes that are to be left out.
    """

    def __init__(
        self,
        cloud: str | os.PathLike[str],
        traffic: str | os.PathLike[str] | None,
        without: Sequence[int] = (),
    ) -> None:
        self._cloud = CloudTiles(cloud)
        rows = [tile.rows for tile in self._cloud.tiles]
        self._starts = np.cumsum([0, *rows])
        self._passed = (
            np.zeros(self._cloud.points, bool)
            if traffic is None
            else read_table(traffic)["traffic"].to_numpy()
        )
        if len(self._passed) != self._cloud.points:
            raise InputError(
                "is not the mask of this cloud",
                where=str(traffic),
                found=f"{len(self._passed)} points",
                allowed=f"{self._cloud.points} as in {cloud}",
                hint="delete it and run the workflow again",
            )
        if without:
            classes = self._cloud.read(["classification"])["classification"]
            left_out = np.isin(classes, without)
            if not left_out.any():
                raise InputError(
                    "no point of the cloud is of a class that is to be left out",
                    where=str(cloud),
                    allowed=f"classes {', '.join(map(str, without))}",
                    hint="classify the cloud, or let lidar.vegetation keep them",
                )
            self._passed = self._passed | left_out
        self.tiles = self._cloud.tiles
        self.points = int(self._cloud.points - self._passed.sum())

    def xyz(self, tile: int) -> Floats32:
        """Positions (n, 3) of a tile's standing points, local metres."""
        passed = self._passed[self._starts[tile] : self._starts[tile + 1]]
        return stack_xyz(self._cloud.read(POSITION, [tile]))[~passed]

    def around(self, tile: int, reach_m: float) -> Floats32:
        """Positions (n, 3) of other tiles' standing points within reach of a tile's box."""
        west, south, _, east, north, _ = self.tiles[tile].bounds_m
        box = (west - reach_m, south - reach_m, east + reach_m, north + reach_m)
        parts: list[Floats32] = [np.empty((0, 3), np.float32)]
        for number, other in enumerate(self.tiles):
            if number != tile and _overlap(other.bounds_m, box):
                xyz = self.xyz(number)
                parts.append(xyz[_inside(xyz, box)])
        return np.concatenate(parts)

    def xyz_within(self, bounds_m: Bounds) -> Floats32:
        """Positions (n, 3) of the standing points in a box (west, south, east, north)."""
        parts: list[Floats32] = [np.empty((0, 3), np.float32)]
        for number, tile in enumerate(self.tiles):
            if _overlap(tile.bounds_m, bounds_m):
                xyz = self.xyz(number)
                parts.append(xyz[_inside(xyz, bounds_m)])
        return np.concatenate(parts)


def _overlap(tile: Sequence[float], box: Bounds) -> bool:
    return tile[0] < box[2] and tile[3] >= box[0] and tile[1] < box[3] and tile[4] >= box[1]


def _inside(xyz: Floats32, box: Bounds) -> Bools:
    x, y = xyz[:, 0], xyz[:, 1]
    return (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
