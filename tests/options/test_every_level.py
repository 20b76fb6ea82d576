"""Every level of every option of the schema runs through its stage and gives a sane answer."""

import pytest

from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.config.load import load_config
from roadsight.config.plans import Plan
from roadsight.config.schema import Settings
from roadsight.config.sites import Site
from tests.options import placement_levels, poles_levels
from tests.options.registry import OPEN, RUNS
from tests.options.schema_levels import all_levels

pytestmark = pytest.mark.xdist_group("every_option")
MODULES = placement_levels, poles_levels
"""Where runs are; importing them fills the registry."""


def test_every_level_has_a_run():
    """Add a new level to the `run_of` line of its field in tests/options/*_levels.py."""
    assert all_levels() - set(RUNS) == set(), "levels without a run"
    assert set(RUNS) - all_levels() == set(), "runs of levels that the schema no longer has"
    assert set(OPEN) <= set(RUNS)


@pytest.mark.full
@pytest.mark.parametrize(("path", "level"), sorted(RUNS), ids=lambda part: part)
def test_level(finished, path, level, request):
    if (path, level) in OPEN:
        request.applymarker(pytest.mark.xfail(strict=True, reason=OPEN[path, level]))
    RUNS[path, level](finished, level)


SITE = {"site": "s", "title": "S", "clouds": ["c.laz"]}


def refusal(path: str, wrong: object) -> str:
    """What a wrong level of a field is told."""
    *sections, field = path.split(".")
    content: dict = {field: wrong}
    for section in reversed(sections):
        content = {section: content}
    with pytest.raises(InputError) as refused:
        if sections[:1] == ["plan"]:
            validated(Plan, {"title": "P", "sensors": ["OS-32"]} | content["plan"], "plans")
        elif set(content) <= set(Settings.model_fields):
            load_config(content)
        else:
            validated(Site, SITE | content, "site")
    return str(refused.value)


@pytest.mark.parametrize("path", sorted({path for path, _ in RUNS if path != "sensor"}))
def test_an_unknown_level_is_refused_with_those_that_there_are(path):
    told = refusal(path, ["no-such"] if path in ("sightings.kinds", "jobs") else "no-such")
    levels = {level for own, level in RUNS if own == path}
    assert path.removeprefix("plan.") in told and "no-such" in told
    assert (
        "boolean" in told if levels == {"True", "False"} else all(level in told for level in levels)
    )
