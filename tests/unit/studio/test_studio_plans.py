import io
import json
import shutil

import numpy as np
import pandas as pd
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.config.plans import Plan, PlanOptions
from roadsight.io.vector.known import read_points
from roadsight.io.vector.vectors import read_polygons
from roadsight.studio.layout import Layouts
from roadsight.studio.plan_files import (
    Barred,
    Export,
    PlanBody,
    Standing,
    about_plans,
    exported,
    remove_plan,
    save_plan,
)
from roadsight.studio.project import Project
from roadsight.studio.site_files import OutdatedError
from tests.conftest import PROJECT
from tests.helpers.report_site import ReportSite
from tests.helpers.small_workflow import without_sites

SETTINGS = {"shards": 1, "coverage": {"shards": 1, "uncoverable": "exclude"}}
PLAN = "puck-32c-or-os-32"
HEAD = "# Our road\nsite: tiny\nclouds: [x.laz]\njobs: [placement] # for now\n"


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    root = without_sites(tmp_path_factory.mktemp("project"))
    ReportSite(root / "results", "tiny", hidden=0.1)
    return root


@pytest.fixture
def project(source, monkeypatch):
    folder = source / "config/sites"
    shutil.rmtree(folder)
    folder.mkdir()
    (folder / "tiny.yaml").write_text(HEAD + yaml.safe_dump({"settings": SETTINGS}))
    monkeypatch.chdir(source)
    return Project(source)


def native(project, x, y):
    return project.site("tiny").frame().to_native(np.array([[x, y, 0.0]]))[0, :2].tolist()


def what_if(project, **more):
    x, y = native(project, 10.0, 5.0)
    u, v = native(project, 20.0, -5.0)
    body = {
        "title": "Agreed: on the left", "sensors": ["OS1-32"], "base": PLAN,
        "mandatory": [Standing(x=x, y=y, kind="OS1-32", height_m=4.5)],
        "forbidden": [Barred(x=u, y=v, half_m=1.5)],
    }  # fmt: skip
    return PlanBody(**(body | more))


def test_a_what_if_is_a_plan_that_the_workflow_reads(project):
    changed, _ = save_plan(project, "tiny", "agreed", what_if(project, at_least=2))
    assert sorted(changed) == [
        "config/sites/tiny.yaml",
        "config/sites/tiny/agreed.forbidden.geojson",
        "config/sites/tiny/agreed.mandatory.csv",
    ]
    text = (project.root / "config/sites/tiny.yaml").read_text()
    assert text.startswith(HEAD)
    site = project.site("tiny")
    plan, frame = site.resolved.plans["agreed"], site.frame()
    assert (plan.title, plan.sensors, plan.at_least) == ("Agreed: on the left", ["OS1-32"], 2)
    points = read_points(plan.mandatory.file, frame, None, ["height_m"])
    assert points[["x", "y", "height_m"]].to_numpy()[0] == pytest.approx([10, 5, 4.5], abs=1e-3)
    assert points["kind"].tolist() == ["OS1-32"]
    (square,) = read_polygons(plan.forbidden.file, frame).geometry
    assert square.bounds == pytest.approx((18.5, -6.5, 21.5, -3.5), abs=1e-3)


def test_saving_again_asks_first_and_keeps_what_is_not_given(project):
    save_plan(project, "tiny", "agreed", what_if(project))
    with pytest.raises(InputError, match="is the name of a plan already"):
        save_plan(project, "tiny", "agreed", what_if(project))
    edited = PlanBody(
        title="Less", sensors=["OS1-32"], base="agreed", replace=True, goal="sensors", amount=3
    )
    assert save_plan(project, "tiny", "agreed", edited)[0] == ["config/sites/tiny.yaml"]
    plan = project.site("tiny").resolved.plans["agreed"]
    assert plan.budget.sensors == 3 and plan.mandatory is not None and plan.forbidden is not None
    none = edited.model_copy(update={"mandatory": [], "goal": "price", "amount": 0.5})
    save_plan(project, "tiny", "agreed", none)
    plan = project.site("tiny").resolved.plans["agreed"]
    assert plan.mandatory is None and plan.price == 0.5 and plan.budget is None


def test_places_that_are_left_are_added_to_those_that_the_base_forbids(project):
    save_plan(project, "tiny", "agreed", what_if(project))
    save_plan(project, "tiny", "second", what_if(project, base="agreed", mandatory=[]))
    site = project.site("tiny")
    file = site.resolved.plans["second"].forbidden.file
    assert len(read_polygons(file, site.frame())) == 2


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"sensors": ["unheard-of"], "mandatory": []}, "unknown sensor"),
        ({"goal": "cost"}, "needs an amount"),
        ({"base": "nothing"}, "no such plan"),
        ({"mandatory": [Standing(x=1, y=2), Standing(x=1, y=2.001)]}, "at the place of another"),
        ({"mandatory": [Standing(x=1, y=2, kind="5400000")]}, "place 1: names no sensor of the"),
        ({"sensors": ["OS1-32", "VLP-16"], "mandatory": [Standing(x=1, y=2)]}, "found nothing"),
        ({"goal": "sensors", "amount": 2.7}, "is no whole number; found 2.7"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_is_written(project, change, told):
    before = (project.root / "config/sites/tiny.yaml").read_bytes()
    with pytest.raises(InputError, match=told):
        save_plan(project, "tiny", "agreed", what_if(project, **change))
    assert (project.root / "config/sites/tiny.yaml").read_bytes() == before
    assert not (project.root / "config/sites/tiny").exists()


def test_places_that_are_taken_out_take_their_file_along_and_may_come_back(project):
    folder = project.root / "config/sites/tiny"
    save_plan(project, "tiny", "agreed", what_if(project))
    save_plan(project, "tiny", "agreed", what_if(project, mandatory=[], replace=True))
    assert [path.name for path in folder.iterdir()] == ["agreed.forbidden.geojson"]
    save_plan(project, "tiny", "agreed", what_if(project, replace=True))
    assert (folder / "agreed.mandatory.csv").exists()


def test_a_file_that_another_plan_names_stays(project):
    save_plan(project, "tiny", "agreed", what_if(project))
    other = PlanBody(title="Other", sensors=["OS1-32"], base="agreed")
    save_plan(project, "tiny", "other", other)
    save_plan(project, "tiny", "agreed", what_if(project, mandatory=[], replace=True))
    remove_plan(project, "tiny", "agreed")
    names = sorted(path.name for path in (project.root / "config/sites/tiny").iterdir())
    assert names == ["agreed.forbidden.geojson", "agreed.mandatory.csv"]


def test_a_plan_that_is_solved_on_request_stays_so_and_keeps_what_it_forbids(project):
    save_plan(project, "tiny", "agreed", what_if(project))
    file = project.root / "config/sites/tiny.yaml"
    content = yaml.safe_load(file.read_text())
    content["placement"]["own_plans"]["agreed"]["on_request"] = True
    file.write_text(yaml.safe_dump(content))
    assert "agreed" not in project.site("tiny").resolved.plans
    x, y = native(project, 30.0, -5.0)
    more = what_if(project, base="agreed", replace=True, forbidden=[Barred(x=x, y=y, half_m=1.0)])
    save_plan(project, "tiny", "agreed", more)
    site = project.site("tiny")
    plan = site.resolved.site.placement.own_plans["agreed"]
    assert plan.on_request
    places = read_polygons(site.resolved.beside(plan.forbidden.file), site.frame())
    assert sorted(round(p.centroid.x) for p in places.geometry) == [20, 30]
    new = more.model_copy(update={"replace": False, "forbidden": None})
    save_plan(project, "tiny", "next", new)
    assert not project.site("tiny").resolved.plans["next"].on_request


def test_what_changed_meanwhile_is_not_overwritten(project):
    shown = about_plans(project, project.site("tiny"))["version"]
    save_plan(project, "tiny", "agreed", what_if(project), shown)
    mine = what_if(project, replace=True)
    with pytest.raises(OutdatedError, match="open the plan again"):
        save_plan(project, "tiny", "agreed", mine, shown)
    with pytest.raises(OutdatedError, match="open the plan again"):
        remove_plan(project, "tiny", "agreed", shown)
    now = about_plans(project, project.site("tiny"))["version"]
    path = project.root / "config/sites/tiny/agreed.mandatory.csv"
    path.write_text(path.read_text().replace("4.5", "5.5"))
    with pytest.raises(OutdatedError):
        save_plan(project, "tiny", "agreed", mine, now)
    remove_plan(project, "tiny", "agreed", about_plans(project, project.site("tiny"))["version"])


def test_a_level_is_left_out_where_places_are_given_and_this_is_said(project):
    file = project.root / "config/sites/tiny.yaml"
    level = {"title": "Level", "sensors": ["OS1-32"], "availability": 0.9}
    content = yaml.safe_load(file.read_text()) | {"placement": {"own_plans": {"level": level}}}
    file.write_text(yaml.safe_dump(content))
    kept = PlanBody(title="Kept", sensors=["OS1-32"], base="level")
    assert save_plan(project, "tiny", "kept", kept)[1] == ""
    _, dropped = save_plan(project, "tiny", "drawn", what_if(project, base="level"))
    assert "availability: 0.9 of the plan level is left out" in dropped
    own = project.site("tiny").resolved.site.placement.own_plans
    assert own["kept"].availability == 0.9 and own["drawn"].availability is None
    assert own["drawn"].mandatory is not None


def test_a_plan_of_all_sites_is_not_shadowed(project):
    with pytest.raises(InputError, match="choose another one"):
        save_plan(project, "tiny", PLAN, what_if(project, replace=True))


def test_an_own_plan_is_taken_away_with_its_places(project):
    before = (project.root / "config/sites/tiny.yaml").read_text()
    save_plan(project, "tiny", "agreed", what_if(project))
    own = {one["name"]: one for one in about_plans(project, project.site("tiny"))["plans"]}
    assert own["agreed"]["own"] and own["agreed"]["mandatory"] and not own[PLAN]["own"]
    remove_plan(project, "tiny", "agreed")
    assert list((project.root / "config/sites/tiny").iterdir()) == []
    assert yaml.safe_load((project.root / "config/sites/tiny.yaml").read_text()) == (
        yaml.safe_load(before)
    )
    with pytest.raises(InputError, match="no plan of this site alone"):
        remove_plan(project, "tiny", "agreed")


def test_sensors_are_exported_where_they_stand_and_a_plan_reads_them(project, tmp_path):
    layout, site = Layouts(project).of("tiny", PLAN), project.site("tiny")
    rows = layout.chosen.tolist()

    def export(kind):
        return exported(site, PLAN, layout, Export(version=layout.version, rows=rows, format=kind))

    name, content = export("csv")
    table = pd.read_csv(io.BytesIO(content))
    expected = layout.places.iloc[rows][["x", "y", "z"]].to_numpy()
    assert layout.frame.to_local(table[["x", "y", "z"]]) == pytest.approx(expected, abs=2e-3)
    (tmp_path / name).write_bytes(content)
    points = read_points(tmp_path / name, layout.frame, None, ["height_m"])
    assert points["kind"].tolist() == layout.choices["sensor"].iloc[rows].tolist()
    assert len(json.loads(export("geojson")[1])["features"]) == len(rows)
    plan = yaml.safe_load(export("yaml")[1])["placement"]["own_plans"][f"{PLAN}-as-drawn"]
    assert plan["mandatory"] == {"file": name}
    assert plan["budget"] == {"sensors": len(rows)}
    nothing = Export(version=layout.version, rows=[], format="yaml")
    with pytest.raises(InputError, match="no sensor stands"):
        exported(site, PLAN, layout, nothing)


def test_the_form_asks_for_what_the_settings_say(project):
    fields = about_plans(project, project.site("tiny"))["fields"]
    assert fields["at_least"] == {
        "default": None,
        "description": PlanOptions.model_fields["at_least"].description,
        "title": "At Least",
        "type": "integer",
        "minimum": 1,
    }
    assert fields["price"]["exclusiveMinimum"] == 0 and fields["price"]["maximum"] == 1e12
    assert (fields["sensors"]["type"], fields["cost"]["minimum"]) == ("integer", 0)
    assert (fields["title"]["minLength"], fields["title"]["maxLength"]) == (1, 200)
    assert fields["title"]["description"] == Plan.model_fields["title"].description
    assert fields["name"]["pattern"] == "^[a-z0-9][a-z0-9_-]*$"


@pytest.mark.parametrize("form", ["plans/form.js", "edges/panel.js"])
def test_no_form_writes_a_range_again(form):
    script = (PROJECT / "workflow/roadsight/studio/assets/js" / form).read_text()
    assert not [text for text in ("min:", "max:", "pattern:") if text in script]
