from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.triangulate.site import apply_decisions
from roadsight.studio import pole_review
from roadsight.studio.pole_review import Decision, Pictures, review, save_decisions
from roadsight.studio.project import Project
from tests.helpers.report_poles import PolesSite
from tests.helpers.small_workflow import without_sites


@pytest.fixture
def project(tmp_path, monkeypatch):
    without_sites(tmp_path)
    poles = {"videolog": "videolog.csv", "images": "images", "masks": [{"model": "m.yaml"}]}
    site = {"site": "drive", "jobs": ["poles"], "clouds": ["x.laz"], "poles": poles}
    text = "# mine\n" + yaml.safe_dump(site | {"settings": {"shards": 2}})
    (tmp_path / "config/sites/drive.yaml").write_text(text)
    PolesSite(tmp_path / "results", "drive", length_m=160.0, poles=8)
    monkeypatch.chdir(tmp_path)
    return Project(tmp_path)


def on(pole, decision, **to):
    x, y = pole["base"]
    return Decision(decision=decision, kind=pole["kind"], x=x, y=y, pole=pole["id"], **to)


def test_decisions_are_kept_found_again_and_taken_back(project):
    first, second, third, *_ = review(project.site("drive"))["poles"]
    asked = [
        on(first, "reject"),
        on(second, "accept"),
        on(third, "move", to_x=third["base"][0] + 3, to_y=third["base"][1]),
    ]
    changed = save_decisions(project, "drive", asked)
    assert changed == ["config/sites/drive/pole_decisions.csv", "config/sites/drive.yaml"]
    assert Path("config/sites/drive.yaml").read_text().startswith("# mine\n")
    assert save_decisions(project, "drive", asked) == []
    found = review(project.site("drive"))
    assert [pole["decision"] is not None for pole in found["poles"][:4]] == [True] * 3 + [False]
    assert found["gone"] == [] and len(found["decisions"]) == 3
    assert save_decisions(project, "drive", []) == ["config/sites/drive.yaml"]
    assert review(project.site("drive"))["decisions"] == []


def test_a_pole_that_the_workflow_has_moved_is_shown_where_it_was_computed(project):
    pole = review(project.site("drive"))["poles"][2]
    x, y = pole["base"]
    save_decisions(project, "drive", [on(pole, "move", to_x=x + 30, to_y=y - 8)])
    found = review(project.site("drive"))
    path = Path("results/drive/poles/poles.parquet")
    decisions = pd.DataFrame(found["decisions"]).astype({"x": float, "y": float})
    write_table(path, apply_decisions(read_table(path), decisions)[0], {})
    again = review(project.site("drive"))["poles"][2]
    assert np.allclose([again["x"], again["y"]], [x + 30, y - 8], atol=1e-3)
    assert np.allclose(again["base"], [x, y], atol=1e-3) and again["decision"] == 0


def test_each_sighting_is_of_one_pole_and_decisions_without_a_pole_are_told(project):
    found = review(project.site("drive"))
    assert any(pole["seen"] for pole in found["poles"])
    for pole in found["poles"]:
        images = [one["image"] for one in pole["seen"]]
        assert len(set(images)) == len(images)
        assert all(one["u_min"] <= one["u_foot"] <= one["u_max"] for one in pole["seen"])
    far = Decision(decision="reject", kind="pole", x=9e5, y=0.0, pole="gone")
    save_decisions(project, "drive", [far])
    assert review(project.site("drive"))["gone"] == [0]


def test_wrong_requests_are_refused(project):
    pole = review(project.site("drive"))["poles"][0]
    with pytest.raises(InputError, match="new place"):
        save_decisions(project, "drive", [on(pole, "move")])
    with pytest.raises(InputError, match="no such image"):
        Pictures().of(project.site("drive"), "../../etc/passwd", "front")
    image = read_table("results/drive/poles/frames.parquet")["image"].iloc[0]
    for view in ("image", "left' or '1"):
        with pytest.raises(InputError, match="no such image"):
            Pictures().of(project.site("drive"), image, view)


def test_the_folder_of_images_is_walked_once_and_again_where_it_changed(project, monkeypatch):
    walked = []
    walk = pole_review.ImageSource
    monkeypatch.setattr(pole_review, "ImageSource", lambda path: walked.append(1) or walk(path))
    site, pictures = project.site("drive"), Pictures()
    frames = read_table("results/drive/poles/frames.parquet")
    frames = frames[frames["path"].fillna("") != ""]
    images = list(frames["image"])[:3]
    folder = Path(pole_review.images_of(site))
    for name in frames["path"]:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(name.encode())
    for image in images:
        content, _ = pictures.of(site, image, "front")
        assert content.decode() == frames.set_index("image").loc[image, "path"]
    assert len(walked) == 1
    place = folder / frames.set_index("image").loc[images[0], "path"]
    place.unlink()
    with pytest.raises(InputError):
        pictures.of(site, images[0], "front")
    place.write_bytes(b"new")
    assert pictures.of(site, images[0], "front")[0] == b"new"
