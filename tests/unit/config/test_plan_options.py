import json

import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.config.load import load_config, load_site
from roadsight.config.plans import Plan
from roadsight.config.schema import Config


def plan(**options):
    return validated(Plan, {"title": "t", "sensors": ["OS-64"], **options}, "plans.yaml")


def site_file(folder, **placement):
    content = {"site": "here", "sample": {}, "placement": placement}
    path = folder / "here.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_site(str(path), load_config(Config().model_dump()))


def test_options_say_only_what_is_set_and_leave_files_out():
    assert plan().options() == ""
    found = plan(spacing_m=20, areas={"file": "areas.gpkg"}, budget={"sensors": 3})
    assert json.loads(found.options()) == {
        "areas": {"crs": None},
        "budget": {"cost": None, "sensors": 3},
        "spacing_m": 20.0,
    }
    assert found.file_of("areas") == "areas.gpkg"
    assert found.file_of("poles") is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"budget": {"sensors": 3}, "price": 1}, "budget and price exclude each other"),
        ({"curve": 5, "price": 1}, "curve and price exclude each other"),
        ({"budget": {}}, "either sensors or cost"),
        ({"budget": {"sensors": 1, "cost": 2}}, "either sensors or cost"),
        ({"keep_share": 1.5}, "keep_share"),
        ({"price": 0}, "price"),
        ({"spacing": 3}, "did you mean 'spacing_m'"),
        ({"poles": {"within_m": 3}}, "poles.file"),
    ],
)
def test_nonsense_is_one_message(options, message):
    with pytest.raises(InputError) as error:
        plan(**options)
    assert message in str(error.value)


@pytest.mark.parametrize("setting", ["solver", "verify"])
def test_highs_and_availability_are_refused_before_any_work(tmp_path, setting):
    own = {"often": {"title": "O", "sensors": ["OS1-64"], "availability": 0.9}}
    path = tmp_path / "here.yaml"
    content = {"site": "here", "sample": {}, "placement": {"own_plans": own}}
    path.write_text(yaml.safe_dump(content))
    config = Config(cover={setting: "highs"}).model_dump()
    with pytest.raises(InputError, match=f"cover.{setting}: highs cannot state the availability"):
        load_site(str(path), load_config(config))


def test_own_plans_of_a_site_join_or_replace_those_of_the_file(tmp_path):
    own = {
        "tight": {"title": "Tight", "sensors": ["OS-64"], "areas": {"file": "a.gpkg"}},
        "os-64": {"title": "Apart", "sensors": ["OS-64"], "spacing_m": 9},
    }
    found = site_file(tmp_path, plans=["os-32", "os-64"], own_plans=own)
    assert list(found.plans) == ["os-32", "os-64", "tight"]
    assert found.plans["os-64"].spacing_m == 9
    assert found.plans["tight"].file_of("areas") == str(tmp_path / "a.gpkg")
    with pytest.raises(InputError, match="unknown sensor"):
        site_file(tmp_path, own_plans={"x": {"title": "X", "sensors": ["OS-65"]}})
