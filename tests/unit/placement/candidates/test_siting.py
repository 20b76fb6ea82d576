import numpy as np
import pandas as pd
import pytest
from scipy import sparse

from roadsight.geometry.frames import Frame
from roadsight.io.vector.known import read_points
from roadsight.placement.candidates.siting import snapped
from roadsight.placement.plans.plan_problem import choices_of
from roadsight.placement.sensors.poses import Turn, pose_name
from roadsight.studio.plan_files import Standing, write_standing

FRAME = Frame((458000.0, 5428000.0, 110.0))
TURNS = [Turn(yaw, pitch, 0.0) for yaw in (-170.0, 0.0, 45.0, 170.0) for pitch in (-20.0, -5.0)]


@pytest.fixture
def aimed():
    """Candidates at two places and heights, choices in all poses, and what each sees."""
    rows = [(f"{key}-h{h}", x, h) for key, x in (("a", 0.0), ("b", 20.0)) for h in (4.0, 6.0)]
    candidates = pd.DataFrame(rows, columns=["candidate", "x", "height_m"])
    candidates = candidates.assign(y=0.0, z=candidates["height_m"], yaw_deg=90.0)
    names = [pose_name(name, turn) for name in candidates["candidate"] for turn in TURNS]
    detections = pd.DataFrame({"sensor": "eye", "candidate": names})
    choices = choices_of({"eye": 1.0}, candidates, detections)
    dense = np.random.default_rng(5).random((len(choices), 40)) < 0.4
    return candidates, choices, sparse.csr_matrix(dense)


def found(aimed, points):
    candidates, choices, matrix = aimed
    free = np.zeros(len(candidates), bool)
    return snapped(points, candidates, choices, matrix, free, 3.0, "plan p")


def test_a_place_that_was_saved_looks_as_it_did(aimed, tmp_path):
    candidates, choices, _ = aimed
    for row, choice in choices.iterrows():
        place = candidates.iloc[choice["position"]]
        x, y = FRAME.to_native(place[["x", "y", "z"]].to_numpy(float)[None])[0, :2]
        meant = Standing(
            x=x, y=y, kind="eye", height_m=place["height_m"], candidate=choice["candidate"]
        )
        write_standing(tmp_path / "m.csv", [meant])
        points = read_points(tmp_path / "m.csv", FRAME, None, ["height_m"], ["candidate"])
        assert found(aimed, points) == [row]


def test_a_pose_that_is_there_no_more_is_the_nearest_one(aimed):
    point = {"id": ["s"], "kind": ["eye"], "x": [0.0], "y": [0.0], "height_m": [4.0]}
    name = pose_name("gone", Turn(-178.0, -6.0, 0.0))
    (row,) = found(aimed, pd.DataFrame(point | {"candidate": [name]}))
    assert aimed[1]["candidate"][row] == pose_name("a-h4.0", Turn(-170.0, -5.0, 0.0))
    name = pose_name("gone", Turn(178.0, -19.0, 0.0))
    (row,) = found(aimed, pd.DataFrame(point | {"candidate": [name]}))
    assert aimed[1]["candidate"][row] == pose_name("a-h4.0", Turn(170.0, -20.0, 0.0))


def test_a_place_without_a_pose_takes_the_one_that_sees_most(aimed):
    _, choices, matrix = aimed
    point = {"id": ["s"], "kind": ["eye"], "x": [20.0], "y": [0.0], "height_m": [6.0]}
    seen = np.diff(matrix.indptr)
    here = np.flatnonzero(choices["position"] == 3)
    for more in ({}, {"candidate": [""]}, {"candidate": ["b-h6.0"]}):
        (row,) = found(aimed, pd.DataFrame(point | more))
        assert row in here and seen[row] == seen[here].max()
