import pytest

from roadsight.base.errors import InputError
from roadsight.studio.project import Project
from roadsight.studio.site_files import CloudBody, new_site
from tests.helpers.las_files import random_points, wkt_of, write_las
from tests.helpers.small_workflow import without_sites

UTM = wkt_of("EPSG:25832")


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.chdir(without_sites(tmp_path))
    return Project(tmp_path)


def test_a_cloud_is_looked_at_and_written_only_when_asked(project, tmp_path):
    cloud = write_las(tmp_path / "My Road (1).laz", random_points(500), UTM)
    asked = CloudBody(path=str(cloud))
    looked = new_site(project, asked)
    assert looked["file"] == "config/sites/my_road_1.yaml" and not looked["written"]
    assert "500 points" in looked["found"][0] and "from the header" in looked["assumed"]["crs"]
    assert "sparse" in looked["doubts"][0] and looked["missing"] == {}
    assert project.stems() == []
    assert new_site(project, asked.model_copy(update={"write": True}))["written"]
    assert project.stems() == ["my_road_1"] and project.group("my_road_1") == "own"
    with pytest.raises(InputError, match="exists already"):
        new_site(project, asked)


def test_what_the_header_lacks_may_be_given(project, tmp_path):
    cloud = write_las(tmp_path / "bare.laz", random_points(300))
    assert set(new_site(project, CloudBody(path=str(cloud)))["missing"]) == {"crs"}
    given = CloudBody(path=str(cloud), given={"crs": "EPSG:25832"}, site="Bare", write=True)
    assert new_site(project, given)["missing"] == {}
    assert project.site("bare").resolved.site.crs == "EPSG:25832"
    wrong = CloudBody(path=str(cloud), given={"crs": "EPSG:1"}, site="other", write=True)
    with pytest.raises(InputError, match="no CRS that PROJ knows"):
        new_site(project, wrong)
    assert not (tmp_path / "config/sites/other.yaml").exists()


@pytest.mark.parametrize("path", ["/nowhere/a.laz", "config/config.yaml", "/etc/passwd", "."])
def test_only_clouds_are_read(project, path):
    with pytest.raises(InputError, match="no LAS or LAZ file on this machine"):
        new_site(project, CloudBody(path=path))
