import pytest
import yaml

from roadsight.studio.project import Project
from tests.helpers.small_workflow import without_sites

POLES = {"videolog": "v.csv", "images": ".", "masks": [{"labels": "l", "map": "m.yaml"}]}
SITES = {
    "a_sample": {"sample": {"scene": "highway"}},
    "audit_x": {"sample": {"scene": "highway"}},
    "z_own": {"clouds": ["z.laz"], "jobs": ["placement"]},
    "b_own": {"clouds": ["z.laz"], "jobs": ["poles"], "poles": POLES},
    "gone": {"clouds": ["${NOT_SET_HERE}/x.laz"]},
    "moved": {"clouds": ["elsewhere.laz"], "jobs": ["scene"]},
}


@pytest.fixture
def project(tmp_path, monkeypatch):
    without_sites(tmp_path)
    (tmp_path / "config/sites/z.laz").touch()
    config = tmp_path / "config/config.yaml"
    config.write_text(
        config.read_text().replace("sites: [sample, sample_rural]", "sites: [a_sample, z_own]")
    )
    for name, content in SITES.items():
        text = yaml.safe_dump({"site": name, "jobs": ["placement"], **content})
        (tmp_path / f"config/sites/{name}.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return Project(tmp_path)


def test_own_sites_come_before_samples_audits_and_those_that_cannot_run(project):
    assert project.stems() == ["z_own", "b_own", "a_sample", "audit_x", "gone", "moved"]
    groups = [site["group"] for site in project.overview()["sites"]]
    assert groups == ["own", "own", "sample", "audit", "absent", "absent"]


def test_a_page_that_cannot_work_says_why(project):
    def cannot(stem):
        return next(s["cannot"] for s in project.overview()["sites"] if s["stem"] == stem)

    assert cannot("z_own") == {
        "edges": "no cloud yet",
        "registration": "no images asked for",
        "results": "no cloud yet",
    }
    assert cannot("b_own")["registration"] == "no images yet"
    assert cannot("moved")["results"] == "neither sensors nor poles asked for"
    for name in ("scene/cloud.parquet", "placement/os-64/solution.json"):
        path = project.root / "results/z_own" / name
        path.parent.mkdir(parents=True)
        path.touch()
    assert cannot("z_own") == {"registration": "no images asked for"}
