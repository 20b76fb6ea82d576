import numpy as np
import pandas as pd
import pytest

from roadsight.placement.sight.objects import (
    connected,
    kind_of_name,
    kinds_of_objects,
    objects_of,
    place_of_name,
)
from roadsight.placement.sight.obstacles import by_object, object_finder

UP = np.array([0.0, 0.0, 1.0])


def wall(x, y, z, step=0.2):
    grid = np.stack(np.meshgrid(np.arange(*x, step), np.arange(*z, step)), -1).reshape(-1, 2)
    xyz = np.column_stack([grid[:, 0], np.full(len(grid), y), grid[:, 1]])
    return xyz, np.tile([0.0, 1.0, 0.0], (len(xyz), 1))


def pole(x, y, height):
    angle, z = np.meshgrid(np.linspace(0, 2 * np.pi, 6), np.arange(0.4, height, 0.2))
    angle, z = angle.ravel(), z.ravel()
    normal = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(z))])
    return np.column_stack([x + 0.1 * normal[:, 0], y + 0.1 * normal[:, 1], z]), normal


def crown(x, y, rng, radius=2.0, z=4.0):
    way, normal = rng.normal(size=(2, 900, 3))
    xyz = (
        way / np.linalg.norm(way, axis=1, keepdims=True) * radius * rng.random((900, 1)) ** (1 / 3)
    )
    return xyz + np.array([x, y, z]), normal / np.linalg.norm(normal, axis=1, keepdims=True)


@pytest.fixture
def scene(rng):
    building = [np.concatenate(p) for p in zip(wall((40, 48), 9, (0.4, 6)), strict=True)]
    roof = np.stack(np.meshgrid(np.arange(40, 48, 0.2), np.arange(9, 13, 0.2)), -1).reshape(-1, 2)
    building = (
        np.concatenate([building[0], np.column_stack([roof, np.full(len(roof), 6.0)])]),
        np.concatenate([building[1], np.tile(UP, (len(roof), 1))]),
    )
    panel = wall((60, 61.5), 0, (1.6, 2.8))
    post = pole(60.7, 0.0, 1.7)
    sign = tuple(np.concatenate(both) for both in zip(panel, post, strict=True))
    return {
        "barrier": wall((0, 15), 0, (0.4, 0.9)), "pole": pole(20, 0, 7.0),
        "tree": crown(30, 0, rng), "bush": crown(35, 0, rng, 0.6, 0.8), "building": building,
        "sign": sign,
    }  # fmt: skip


def test_kinds_by_their_shape(scene):
    found = {name: kind_of(xyz, n, xyz[:, 2]) for name, (xyz, n) in scene.items()}
    assert found == {name: name for name in scene}


def kind_of(xyz_m, normal, height_m):
    """One object by itself, step by step."""
    top = np.percentile(height_m, 98)
    away = np.hypot(*(xyz_m[:, :2] - np.median(xyz_m[:, :2], axis=0)).T)
    across, along = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(xyz_m[:, :2].T)), 0.0))
    if top >= 2.5 and np.percentile(away, 90) <= 0.5:
        return "pole"
    if top <= 1.6 and 3.5 * along >= 4.0 and along >= 4 * across:
        return "barrier"
    cells, cube, count = np.unique(
        np.floor(xyz_m / 0.8), axis=0, return_inverse=True, return_counts=True
    )
    agreements = [
        np.linalg.eigvalsh(normal[cube.ravel() == k].T @ normal[cube.ravel() == k] / count[k])[-1]
        for k in range(len(cells))
    ]
    many = count >= 3
    if many.any() and np.average(np.array(agreements)[many], weights=count[many]) < 0.8:
        return "tree" if top >= 1.5 else "bush"
    if top >= 1.5 and across <= 0.15 and 3.5 * along <= 5.0:
        return "sign"
    footprint = len(np.unique(np.floor(xyz_m[:, :2]), axis=0))
    return "building" if top >= 2.5 and footprint >= 4.0 else "object"


def test_kinds_of_all_at_once_are_those_of_each_alone(scene, rng):
    parts = [*scene.values()]
    for _ in range(60):
        middle, spread = rng.uniform(-500, 500, 3), rng.uniform(0.05, 4.0, 3)
        xyz = middle + rng.normal(size=(rng.integers(4, 80), 3)) * spread
        normal = UP + rng.normal(size=xyz.shape) * rng.uniform(0, 2)
        parts.append((xyz, normal / np.linalg.norm(normal, axis=1, keepdims=True)))
    group = np.repeat(np.arange(len(parts)), [len(xyz) for xyz, _ in parts])
    xyz, normal = (np.concatenate(both) for both in zip(*parts, strict=True))
    height_m = np.abs(xyz[:, 2]) % 7.0
    mixed = rng.permutation(len(xyz))
    found = kinds_of_objects(xyz[mixed], normal[mixed], height_m[mixed], group[mixed])
    alone = [
        kind_of(xyz[group == k], normal[group == k], height_m[group == k])
        for k in range(len(parts))
    ]
    assert found == alone
    assert len(set(found)) >= 4


def test_objects_of_a_scene_have_stable_names(scene):
    xyz = np.concatenate([part[0] for part in scene.values()])
    normal = np.concatenate([part[1] for part in scene.values()])
    ground = np.column_stack([np.arange(0, 70, 0.5), np.zeros(140), np.full(140, 0.1)])
    every = np.concatenate([xyz, ground]), np.concatenate([normal, np.tile(UP, (140, 1))])
    row, objects = objects_of(*every, every[0][:, 2])
    assert sorted(objects["kind"]) == sorted(scene)
    assert (row[len(xyz) :] == -1).all()
    assert {kind_of_name(name) for name in objects["name"]} == set(scene)
    places = np.array([place_of_name(name) for name in objects["name"]])
    assert places == pytest.approx(objects[["x", "y"]].to_numpy(), abs=0.5)
    assert place_of_name("tree-12+3-2") == (-12.0, 3.0) and place_of_name("tree") is None
    without = len(scene["barrier"][0])
    _, fewer = objects_of(xyz[without:], normal[without:], xyz[without:, 2])
    assert set(fewer["name"]) < set(objects["name"])


def test_a_barrier_that_meets_a_building_is_an_object_of_its_own(scene):
    touching = wall((30, 40.2), 9, (0.4, 0.9))
    parts = zip(scene["building"], touching, strict=True)
    xyz, normal = (np.concatenate(both) for both in parts)
    _, objects = objects_of(xyz, normal, xyz[:, 2])
    assert sorted(objects["kind"]) == ["barrier", "building"]


def test_a_single_return_is_no_object():
    xyz = np.repeat([[5.0, 5.0, 9.0], [8.0, 5.0, 1.0]], 3, axis=0)
    row, objects = objects_of(xyz, np.tile(np.eye(3), (2, 1)), xyz[:, 2])
    assert objects.empty
    assert (row == -1).all()


def test_what_touches_is_one_object():
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [2.0, 0, 0], [2.3, 0.3, 0.3]])
    groups = connected(points)
    assert groups[0] == groups[1] != groups[2] == groups[3]
    assert len(connected(np.empty((0, 3)))) == 0


def test_obstacles_belong_to_the_nearest_object():
    lines = pd.DataFrame(
        {
            "target": ["a", "b", "b", "c"], "candidate": ["s", "s", "t", "s"],
            "blocked_share": [1.0, 0.5, 1.0, 0.0], "obstacle_x": [1.0, 1.2, 1.1, np.nan],
            "obstacle_y": 0.0, "obstacle_z": 1.0,
        }
    )  # fmt: skip
    members = pd.DataFrame(
        {"x": [1.0, 9.0], "y": 0.0, "z": 1.0, "object": ["tree+1+0", "pole+9+0"]}
    )
    table = by_object(lines, object_finder(members))
    assert table["object"].tolist() == ["tree+1+0"]
    assert table[["sight_lines", "targets", "sensors"]].iloc[0].tolist() == [3, 2, 2]
    assert by_object(lines.iloc[3:], object_finder(members)).empty
    assert by_object(lines, object_finder(members.iloc[:0])).empty
