import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.cameras import Intrinsics, project
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.poles.triangulate.cloud_objects import (
    AGAINST,
    OUT_OF_VIEW,
    OVER_ROAD,
    SEEN,
    UNDECIDED,
    UNSEEN,
    blocks_of,
    confirmed,
    objects_of,
    show,
    trees_of,
)

CAMERA = ViewCamera(Intrinsics.from_field_of_view(640, 480, 60.0), (0.0, 0.0, 2.0), 0.0)


def tree(number, x, y, top=10.0):
    return {"kind": "tree", "object": number, "x": x, "y": y, "z_ground": 0.0, "top_m": top}


def rail(number, x, y0, y1):
    way = np.arange(y0, y1 + 0.5)
    place = {"kind": "guardrail", "object": number, "x": x, "z_ground": 0.0, "top_m": np.nan}
    return [place | {"y": y} for y in way]


def mask_of(cls, xy=(0.0, 20.0), top=10.0, half_m=2.0):
    """Grass below the horizon, sky above, and a class where a tree stands."""
    mask = np.full((480, 640), PixelClass.VEGETATION, np.uint8)
    mask[:240] = PixelClass.SKY
    corners = np.array([[xy[0] - half_m, xy[1], top + 0.5], [xy[0] + half_m, xy[1], 0.0]])
    (a, b), _ = project(CAMERA.intrinsics, CAMERA.rotation(), CAMERA.position_m, corners)
    mask[max(int(a[1]), 0) : int(b[1]), max(int(a[0]), 0) : int(b[0])] = cls
    return mask


@pytest.mark.parametrize(
    ("cls", "answer"),
    [
        (PixelClass.TREE, SEEN), (PixelClass.BUILDING, AGAINST), (PixelClass.SKY, AGAINST),
        (PixelClass.VEHICLE, UNDECIDED), (PixelClass.POLE, UNDECIDED),
    ],
)  # fmt: skip
def test_what_a_mask_shows_at_a_tree_decides(cls, answer):
    (trees,) = objects_of(pd.DataFrame([tree(0, 0.0, 20.0)]))
    assert show(CAMERA, mask_of(cls), trees, 60.0).tolist() == [answer]


def test_what_is_behind_beside_or_too_far_is_out_of_view():
    places = [(0.0, 20.0), (0.0, -20.0), (40.0, 20.0), (0.0, 80.0)]
    (trees,) = objects_of(pd.DataFrame([tree(n, *p) for n, p in enumerate(places)]))
    answers = show(CAMERA, mask_of(PixelClass.TREE), trees, 60.0)
    assert answers.tolist() == [SEEN, *[OUT_OF_VIEW] * 3]


def test_a_rail_is_seen_by_half_of_its_places():
    (rails,) = objects_of(pd.DataFrame(rail(0, 3.0, 8.0, 27.0)))
    uv, _ = project(CAMERA.intrinsics, CAMERA.rotation(), CAMERA.position_m, rails.xyz_m)
    mask = np.full((480, 640), PixelClass.ROAD, np.uint8)
    assert show(CAMERA, mask, rails, 60.0).tolist() == [UNDECIDED]
    column, row = np.round(uv[:12]).astype(int).T
    mask[row, column] = PixelClass.GUARDRAIL
    assert show(CAMERA, mask, rails, 60.0).tolist() == [SEEN]


def test_views_together_decide():
    table = pd.DataFrame(
        [*(tree(n, 0.0, 20.0) for n in range(4)), *rail(0, 3, 8, 20), *rail(1, 3, 8, 20)]
    )
    said = [
        ("tree", 0, "b", SEEN), ("tree", 0, "a", SEEN), ("tree", 0, "c", AGAINST),
        ("tree", 1, "a", SEEN), ("tree", 1, "b", AGAINST), ("tree", 1, "c", AGAINST),
        ("tree", 2, "a", UNDECIDED), ("guardrail", 0, "a", UNDECIDED),
    ]  # fmt: skip
    seen = pd.DataFrame(said, columns=["kind", "object", "image", "answer"]).assign(route="r")
    told = confirmed(table, seen).set_index(["kind", "object"])
    assert told["kept"].to_dict() == {
        ("guardrail", 0): True,  # its shape tells a rail, and nothing contradicts it
        ("guardrail", 1): False,
        ("tree", 0): True,
        ("tree", 1): False,
        ("tree", 2): False,
        ("tree", 3): False,
    }
    assert told.loc[("tree", 0), "images"] == "a;b"
    assert told.loc[("tree", 3), "reason"] == UNSEEN
    assert told["score"].tolist() == [0, 0, 2, 1, 0, 0]


def outline(kind, number, corner, size=(10.0, 8.0)):
    low, high = np.array(corner), np.array(corner) + size
    x, y = np.meshgrid(np.arange(low[0], high[0] + 0.1), np.arange(low[1], high[1] + 0.1))
    edge = (x == low[0]) | (x == high[0]) | (y == low[1]) | (y == high[1])
    places = {"x": x[edge], "y": y[edge], "z_ground": 1.0, "top_m": 6.0}
    return pd.DataFrame(places | {"kind": kind, "object": number, "width_m": 9.0, "sigma_m": 0.3})


@pytest.fixture
def objects():
    """Two buildings beside a road along x, one far from it, a headwall."""
    return pd.concat(
        [
            outline("building", 0, (20.0, 12.0)),
            outline("building", 1, (60.0, -30.0)),
            outline("building", 2, (20.0, 70.0)),
            outline("headwall", 0, (90.0, 5.0), (3.0, 1.0)),
        ],
        ignore_index=True,
    )


TRACK = RouteTracks(
    pd.DataFrame({"route": "r", "sequence": range(15), "x": np.arange(15) * 8.0, "y": 0.0})
)


def said(answers):
    names = ["kind", "object", "answer"]
    return pd.DataFrame(answers, columns=names).assign(image="i.jpg", route="r")


def test_a_building_is_where_it_is_nearest_to_the_road(objects):
    told = confirmed(objects, said([("building", 0, 1), ("building", 1, 0)]))
    found = blocks_of(objects, told, TRACK).set_index("id")
    assert found.index.tolist() == ["building-00000", "building-00001", "headwall-00000"]
    assert found["y"].tolist() == [12.0, -22.0, 5.0]
    assert found["height_m"].tolist() == [6.0, 6.0, 6.0]
    assert found["kept"].all()
    # One that no image looks at stays: the cloud's class says what it is.
    assert (told.set_index(["kind", "object"]).loc[("headwall", 0), "reason"]) == UNSEEN
    assert found.loc["headwall-00000", ["reason", "score"]].tolist() == ["", 0]


def test_a_building_that_images_contradict_is_withheld(objects):
    told = confirmed(objects, said([("building", 0, -1), ("building", 1, 1)]))
    found = blocks_of(objects, told, TRACK).set_index("id")
    assert not found.loc["building-00000", "kept"]
    assert "something else" in found.loc["building-00000", "reason"]


def test_what_a_track_runs_under_is_a_bridge(objects):
    deck = outline("building", 3, (40.0, -6.0), (10.0, 12.0))
    every = pd.concat([objects, deck], ignore_index=True)
    told = confirmed(every, said([("building", 3, 1)]))
    found = blocks_of(every, told, TRACK).set_index("id")
    bridges = found[~found["kept"]]
    assert bridges["reason"].tolist() == [OVER_ROAD] and abs(bridges["y"].iloc[0]) <= 1.0


def test_without_blocks_or_track_there_are_none(objects):
    told = confirmed(objects, said([("building", 0, 1)]))
    assert blocks_of(objects[:0], told, TRACK).empty
    nowhere = RouteTracks(pd.DataFrame({"route": [], "sequence": [], "x": [], "y": []}))
    assert blocks_of(objects, told, nowhere).empty


def test_the_only_image_of_a_route_is_a_place_to_be_near(objects):
    told = confirmed(objects, said([("building", 0, 1)]))
    rows = {"route": ["r", "s"], "sequence": 0, "x": [25.0, np.nan], "y": [0.0, np.nan]}
    found = blocks_of(objects, told, RouteTracks(pd.DataFrame(rows)))
    assert found["id"].tolist() == ["building-00000"]
    assert found[["x", "y"]].iloc[0].tolist() == [25.0, 12.0]


@pytest.mark.parametrize(
    ("shows", "trunk", "place"),
    [("crown", [np.nan] * 3, [3.0, 9.0, 0.8]), ("trunk", [3.5, 8.0, 0.1], [3.5, 8.0, 0.1])],
)
def test_trees_have_their_size_and_stand_where_the_cloud_shows_their_trunks(shows, trunk, place):
    tree = {"kind": "tree", "object": 0, "x": 3.0, "y": 9.0, "top_m": 8.0, "width_m": 4.5}
    tree |= dict(zip(("trunk_x", "trunk_y", "trunk_sigma_m"), trunk, strict=True))
    table = pd.DataFrame([tree | {"sigma_m": 0.8, "cloud_shows": shows}])
    found = trees_of(table, confirmed(table, said([("tree", 0, 1)]))).iloc[0]
    assert found[["height_m", "crown_width_m", "cloud_shows"]].tolist() == [8.0, 4.5, shows]
    assert found[["x", "y", "sigma_major_m"]].tolist() == place
    assert found["sigma_minor_m"] == found["sigma_major_m"]
