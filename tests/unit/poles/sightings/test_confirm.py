import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.cameras import Intrinsics, project
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.sightings.confirm import (
    AGAINST,
    OUT_OF_VIEW,
    SEEN,
    UNDECIDED,
    UNSEEN,
    confirmed,
    objects_of,
    show,
)
from roadsight.poles.sightings.sighting_bearing import ViewCamera

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
