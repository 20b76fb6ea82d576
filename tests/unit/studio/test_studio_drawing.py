import json
import os
import shutil
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.scene.splines import spline_line
from roadsight.studio.drawing import Drawing, Edge, edge_line, load_drawing, save_drawing
from roadsight.studio.project import Project
from roadsight.studio.server import create_app
from tests.e2e.studio_project import make_project

EDGE = {"name": "e1", "kind": "median", "points": [[15, 27], [30.125, 27.5], [45, 29]]}
ZONE = {"name": "z1", "points": [[20, 20], [30, 20], [30, 30]]}
POLE = {"name": "p1", "x": 30.0, "y": 12.0, "height_m": 8.5}
OWN = {"Host": "localhost:1", "X-Roadsight-Token": "t"}


@pytest.fixture
def project(tmp_path, monkeypatch):
    folder = make_project(tmp_path / "project", poles=False)
    monkeypatch.chdir(folder)
    return Project(folder)


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    folder = make_project(tmp_path_factory.mktemp("fuzz") / "project", poles=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield create_app(Project(folder), "t").test_client()


def save(project, **layers):
    return save_drawing(project, "tiny", Drawing.model_validate(layers))


def test_what_is_saved_is_loaded(project):
    save(project, edges=[EDGE], zones=[ZONE], mounts=[POLE])
    loaded = load_drawing(project.site("tiny"))
    assert loaded["edges"][0]["name"] == "e1" and loaded["edges"][0]["kind"] == "median"
    np.testing.assert_allclose(loaded["edges"][0]["points"], EDGE["points"], atol=1e-3)
    np.testing.assert_allclose(loaded["zones"][0]["points"], ZONE["points"], atol=1e-3)
    assert loaded["mounts"][0]["height_m"] == 8.5
    assert loaded["own"] == {"edges": True, "zones": True, "mounts": True, "tma": False}


def test_the_form_asks_for_what_is_taken(project):
    fields = load_drawing(project.site("tiny"))["fields"]
    assert fields["kind"]["enum"] == ["edge", "median", "line"]
    assert (fields["height_m"]["exclusiveMinimum"], fields["height_m"]["maximum"]) == (0, 100)
    assert fields["name"]["pattern"].endswith("{0,39}$")


def test_layers_of_a_file_are_read_and_stay_named(project):
    save(project, edges=[EDGE], zones=[ZONE], mounts=[POLE], tma={"remove": [ZONE["points"]]})
    folder, site = Path("config/sites/tiny"), Path("config/sites/tiny.yaml")
    content = yaml.safe_load(site.read_text())
    for name in ("edges", "zones", "mounts", "tma"):
        gpd.read_file(folder / f"{name}.geojson").to_file("config/sites/all.gpkg", layer=name)
        (folder / f"{name}.geojson").unlink()
        content["placement"][name] = f"all.gpkg|layername={name}"
    site.write_text(yaml.safe_dump(content))
    before, loaded = Path("config/sites/all.gpkg").read_bytes(), load_drawing(project.site("tiny"))
    assert loaded["edges"][0]["name"] == "e1" and loaded["zones"][0]["name"] == "z1"
    assert loaded["mounts"][0]["name"] == "p1" and loaded["area"]
    save(project, edges=loaded["edges"])
    named = yaml.safe_load(site.read_text())["placement"]
    assert named == content["placement"] | {"edges": "tiny/edges.geojson"}
    assert Path("config/sites/all.gpkg").read_bytes() == before
    assert load_drawing(project.site("tiny"))["zones"] == loaded["zones"]


def states():
    files = [path for path in Path("config/sites").rglob("*") if path.is_file()]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in files}


def test_saving_again_changes_no_file(project):
    first = save(project, edges=[EDGE], zones=[ZONE], tma={"remove": [ZONE["points"]]})
    assert first == [
        "config/sites/tiny/edges.geojson",
        "config/sites/tiny/zones.geojson",
        "config/sites/tiny/tma.geojson",
        "config/sites/tiny.yaml",
    ]
    loaded, before = load_drawing(project.site("tiny")), states()
    assert save(project, edges=loaded["edges"], zones=loaded["zones"]) == []
    assert save(project, edges=loaded["edges"], tma={}) == []
    assert states() == before


def test_holes_of_zones_stay(project):
    hole = [[22, 21], [26, 21], [26, 24]]
    save(
        project,
        zones=[ZONE | {"points": [[20, 20], [40, 20], [40, 40], [20, 40]], "holes": [hole]}],
    )
    loaded = load_drawing(project.site("tiny"))["zones"]
    assert len(loaded[0]["holes"]) == 1
    np.testing.assert_allclose(sorted(loaded[0]["holes"][0]), sorted(hole), atol=1e-3)
    save(project, zones=loaded, edges=[EDGE])
    assert load_drawing(project.site("tiny"))["zones"] == loaded


def test_parts_of_another_cloud_are_not_mixed_with_this_one(client):
    version = client.get("/api/sites/tiny/cloud", headers=OWN).json["version"]
    path = f"/api/sites/tiny/cloud/0/0?version={version}"
    assert client.get(path, headers=OWN).status_code == 200
    cloud = Path("results/tiny/scene/cloud.parquet")
    before = cloud.stat()
    os.utime(cloud, ns=(before.st_atime_ns, before.st_mtime_ns + 10**9))
    answer = client.get(path, headers=OWN)
    assert answer.status_code == 409 and "reload" in answer.json["error"]
    assert client.get("/api/sites/tiny/cloud", headers=OWN).json["version"] != version


def test_only_the_layers_given_are_touched(project):
    save(project, edges=[EDGE], zones=[ZONE])
    assert save(project, zones=[]) == ["config/sites/tiny.yaml"]
    site = project.site("tiny").resolved.site
    assert site.placement.zones is None and site.placement.edges == "tiny/edges.geojson"
    text = Path("config/sites/tiny.yaml").read_text()
    assert text.startswith("# The site tiny\n")


def test_files_that_the_site_does_not_name_are_not_overwritten(project):
    theirs = Path("config/sites/tiny/edges.geojson")
    theirs.parent.mkdir()
    theirs.write_text("theirs")
    before = states()
    with pytest.raises(InputError, match="does not name it"):
        save(project, edges=[EDGE], zones=[ZONE])
    assert states() == before and theirs.read_text() == "theirs"
    assert save(project, zones=[ZONE])[0] == "config/sites/tiny/zones.geojson"


def test_a_layer_that_is_taken_away_takes_the_studio_s_file_along(project):
    save(project, zones=[ZONE], mounts=[POLE])
    own = Path("config/sites/tiny/zones.geojson")
    save(project, zones=[])
    assert not own.exists() and Path("config/sites/tiny/mounts.geojson").exists()
    save(project, zones=[ZONE])
    theirs = own.rename(own.with_name("theirs.geojson"))
    file = Path("config/sites/tiny.yaml")
    file.write_text(file.read_text().replace("zones.geojson", "theirs.geojson"))
    save(project, zones=[])
    assert theirs.exists()


def test_a_file_that_a_plan_names_stays(project):
    save(project, zones=[ZONE])
    path = Path("config/sites/tiny.yaml")
    plan = {"title": "Mine", "sensors": ["VLP-16"], "forbidden": {"file": "tiny/zones.geojson"}}
    content = yaml.safe_load(path.read_text())
    content["placement"]["own_plans"] = {"mine": plan}
    content["placement"]["plans"] = ["mine"]
    path.write_text(yaml.safe_dump(content))
    save(project, zones=[])
    assert Path("config/sites/tiny/zones.geojson").exists()


def test_nothing_is_saved_over_what_has_changed_meanwhile(client):
    put = lambda version, **layers: client.put(  # noqa: E731
        "/api/sites/tiny/drawing", json=layers, headers=OWN | {"If-Match": version}
    )
    file = Path("config/sites/tiny.yaml")
    before = file.read_bytes()
    try:
        first = client.get("/api/sites/tiny/drawing", headers=OWN).json["version"]
        answer = put(first, edges=[EDGE], zones=[ZONE])
        assert answer.status_code == 200
        version = answer.json["version"]
        edges = file.with_suffix("") / "edges.geojson"
        theirs = edges.read_text().replace("median", "line")
        edges.write_text(theirs)
        for told in (version, first, ""):
            refused = put(told, edges=[EDGE | {"name": "e9"}])
            assert refused.status_code == 409 and "changed meanwhile" in refused.json["error"]
        assert edges.read_text() == theirs
        loaded = client.get("/api/sites/tiny/drawing", headers=OWN).json
        assert loaded["edges"][0]["kind"] == "line"
        assert put(loaded["version"], zones=[]).status_code == 200
        # What does not concern the drawing does not get in its way.
        version = client.get("/api/sites/tiny/drawing", headers=OWN).json["version"]
        file.write_text(file.read_text() + "# a remark\n")
        assert put(version, edges=[]).status_code == 200
        assert file.read_text().endswith("# a remark\n")
    finally:
        file.write_bytes(before)
        shutil.rmtree(file.with_suffix(""))


@pytest.mark.parametrize(
    ("layers", "problem"),
    [
        ({"edges": [EDGE, EDGE]}, "share a name"),
        ({"edges": [EDGE | {"points": [[1, 1], [1, 1]]}]}, "2 different points"),
        ({"edges": [EDGE | {"points": [[0, 0], [2, 2], [2, 0], [0, 2]]}]}, "crosses itself"),
        ({"zones": [ZONE | {"points": [[0, 0], [2, 2], [2, 0], [0, 2]]}]}, "crosses itself"),
        ({"zones": [ZONE | {"points": [[0, 0], [1, 1]]}]}, "3 different corners"),
        ({"tma": {"remove": [[[-999, -999], [999, -999], [999, 999], [-999, 999]]]}}, "is left"),
        ({"tma": {"base": "none"}}, "is left"),
    ],
)
def test_wrong_drawings_write_nothing(project, layers, problem):
    before = Path("config/sites/tiny.yaml").read_bytes()
    with pytest.raises(InputError, match=problem):
        save(project, **layers)
    assert Path("config/sites/tiny.yaml").read_bytes() == before
    assert not Path("config/sites/tiny").exists()


def test_a_site_folder_that_leads_outside_is_not_written(project, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    Path("config/sites/tiny").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="outside the project"):
        save(project, edges=[EDGE])
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_site_file_that_cannot_be_changed_stays(project):
    path = Path("config/sites/tiny.yaml")
    text = path.read_text() + "placement: &p {edges: sample}\ntruth: {poles: x}\n"
    path.write_text(text.replace("jobs:\n- placement\n", "jobs: [placement]\n"))
    assert save(project, edges=[EDGE]) == [
        "config/sites/tiny/edges.geojson",
        "config/sites/tiny.yaml",
    ]


def test_the_preview_is_what_the_workflow_computes(client):
    answer = client.post("/api/sites/tiny/preview", json={"edges": [EDGE]}, headers=OWN)
    spline = spline_line(edge_line(Edge.model_validate(EDGE)))
    shown = np.array(answer.json["edges"][0]["xyz"]).reshape(-1, 3)
    np.testing.assert_allclose(shown[:, :2], np.array(spline.coords), atol=6e-4)
    positions = np.array(answer.json["positions"]).reshape(-1, 4)
    assert len(positions) == int(spline.length // 4) + 1
    assert answer.json["problems"] == []


def test_a_far_edge_is_told_while_it_is_drawn(client):
    far = EDGE | {"points": [[500, 500], [520, 520]]}
    answer = client.post("/api/sites/tiny/preview", json={"edges": [far]}, headers=OWN)
    assert "at most 50 m" in answer.json["problems"][0]


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                ["edges", "zones", "mounts", "tma", "name", "points", "kind", "x", "add"]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.binary(max_size=60) | VALUES.map(lambda value: json.dumps(value).encode()))
def test_no_request_breaks_the_server(client, content):
    headers = OWN | {"Content-Type": "application/json"}
    answer = client.post("/api/sites/tiny/preview", data=content, headers=headers)
    assert answer.status_code in (200, 422), answer.data


def test_other_kinds_of_requests_are_refused(client):
    answer = client.put("/api/sites/tiny/drawing", data="edges=1", headers=OWN)
    assert answer.status_code == 422 and "application/json" in answer.json["error"]
    assert client.put("/api/sites/none/drawing", json={}, headers=OWN).status_code == 422
    large = client.put(
        "/api/sites/tiny/drawing",
        data=b" " * (17 << 20),
        headers=OWN | {"Content-Type": "application/json"},
    )
    assert large.status_code == 413


@pytest.mark.parametrize(
    ("file", "ask"),
    [
        ("scene/frame.json", "cloud"), ("scene/cloud.parquet", "cloud"), ("scene/dem.tif", "cloud"),
        ("scene/pavement.gpkg", "drawing"), ("placement/edges.gpkg", "drawing"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("content", [b"", b"garbage", None])
def test_broken_results_are_told_by_their_file(client, file, ask, content):
    path = Path("results/tiny") / file
    before = path.read_bytes()
    path.write_bytes(before[: len(before) // 2] if content is None else content)
    try:
        answer = client.get(f"/api/sites/tiny/{ask}", headers=OWN)
        assert answer.status_code == 422, answer.data
        assert Path(file).name in answer.json["error"]
    finally:
        path.write_bytes(before)
    assert client.get(f"/api/sites/tiny/{ask}", headers=OWN).status_code == 200


def test_a_broken_site_file_is_told(client):
    path = Path("config/sites/tiny.yaml")
    before = path.read_bytes()
    for text, told in (("site: [", "not valid YAML"), ("site: tiny\nclouds: 3\n", "clouds")):
        path.write_text(text)
        answer = client.get("/api/sites/tiny/drawing", headers=OWN)
        assert answer.status_code == 422 and told in answer.json["error"]
    path.write_bytes(before)
    assert client.get("/api/sites/tiny/drawing", headers=OWN).status_code == 200
