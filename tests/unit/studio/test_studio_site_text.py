import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.studio.site_files import with_value

BLOCK = """\
# Our road
site: road
placement:
  edges: old.csv # digitised by hand
  # which plans
  plans: [os-64]
settings:
  shards: 2
"""


def test_a_value_is_replaced_in_its_place():
    changed = with_value(BLOCK, "placement", "edges", "road/edges.geojson")
    assert changed == BLOCK.replace("old.csv", "road/edges.geojson")


def test_a_key_is_added_to_a_section():
    changed = with_value(BLOCK, "placement", "zones", "road/zones.geojson")
    added = "  zones: road/zones.geojson\n"
    assert changed.replace(added, "") == BLOCK and added in changed


def test_a_section_is_added_at_the_end():
    text = "site: road # no newline at the end"
    changed = with_value(text, "placement", "tma", "t.geojson")
    assert changed == text + "\nplacement:\n  tma: t.geojson\n"


def test_removing_and_the_last_key_takes_its_section():
    gone = with_value(BLOCK, "placement", "edges", None)
    assert gone == BLOCK.replace("  edges: old.csv # digitised by hand\n", "")
    alone = "site: a\nplacement:\n  edges: x\nsettings: {}\n"
    assert with_value(alone, "placement", "edges", None) == "site: a\nsettings: {}\n"
    assert with_value(BLOCK, "placement", "tma", None) == BLOCK


@pytest.mark.parametrize(
    ("text", "value", "expected"),
    [
        ("placement: {edges: sample}\n", "e", {"edges": "e"}),
        ("placement: {edges: sample, tma: t}\n", None, {"tma": "t"}),
        ("placement: {edges: sample}\nsite: a\n", None, None),
        ("placement:\nsite: a\n", "e", {"edges": "e"}),
        ("placement: {}\n", "e", {"edges": "e"}),
        ("placement: {tma: t}\n", "e", {"edges": "e", "tma": "t"}),
        (
            "'placement':\n    'edges': >-\n      long\n      name\n    tma: t\n",
            "e",
            {"edges": "e", "tma": "t"},
        ),
    ],
)
def test_other_ways_to_write_it(text, value, expected):
    changed = yaml.safe_load(with_value(text, "placement", "edges", value)) or {}
    assert changed.get("placement") == expected


def test_values_that_need_quotes_are_quoted():
    for value in ("no", "1e3", "a: b", "- x", "#x", "ä b", "'", '"', "{a}", "null"):
        changed = with_value(BLOCK, "placement", "edges", value)
        assert yaml.safe_load(changed)["placement"]["edges"] == value


def test_what_cannot_be_changed_safely_is_refused():
    text = "a: &x {edges: e}\nplacement: *x\n"
    with pytest.raises(InputError, match="by hand"):
        with_value(text, "placement", "edges", "new")


KEYS = st.sampled_from(["edges", "zones", "mounts", "tma", "plans"])
TEXT = st.text(max_size=12)


@example({}, False, "edges", "\x85")
@example({"zones": "z"}, True, "edges", "a \u2028 b")
@given(st.dictionaries(KEYS, TEXT), st.booleans(), KEYS, st.none() | TEXT)
def test_only_that_value_changes(section, flow, key, value):
    content = {"site": "a", "placement": section, "settings": {"shards": 2}}
    text = yaml.safe_dump(content, default_flow_style=flow, sort_keys=False)
    changed = yaml.safe_load(with_value(text, "placement", key, value))
    assert {name: changed.get(name) for name in ("site", "settings")} == {
        name: content[name] for name in ("site", "settings")
    }
    rest = {name: part for name, part in section.items() if name != key}
    assert (changed.get("placement") or {}) == rest | ({} if value is None else {key: value})


PLAN = {"title": "Ours: it's agreed", "sensors": ["OS1-64"], "budget": {"sensors": 2}}


def test_a_mapping_within_a_section_is_added_replaced_and_removed():
    once = with_value(BLOCK, "own_plans", "on", PLAN, within="placement")
    assert yaml.safe_load(once)["placement"]["own_plans"] == {"on": PLAN}
    twice = with_value(once, "own_plans", "b", {"title": "B"}, within="placement")
    assert yaml.safe_load(twice)["placement"]["own_plans"] == {"on": PLAN, "b": {"title": "B"}}
    assert "# digitised by hand" in twice and "# which plans" in twice
    back = with_value(twice, "own_plans", "b", None, within="placement")
    assert yaml.safe_load(back) == yaml.safe_load(once)
    gone = with_value(back, "own_plans", "on", None, within="placement")
    assert yaml.safe_load(gone) == yaml.safe_load(BLOCK)


def test_a_block_of_plans_keeps_its_comments():
    plan = "    a:\n      title: A\n      sensors: [x]\n"
    text = f"placement:\n  own_plans: # ours\n    # the first\n{plan}z: 1\n"
    added = with_value(text, "own_plans", "b", PLAN, within="placement")
    assert "# the first" in added and "# ours" in added
    assert list(yaml.safe_load(added)["placement"]["own_plans"]) == ["b", "a"]
    replaced = with_value(text, "own_plans", "a", PLAN, within="placement")
    assert yaml.safe_load(replaced) == {"placement": {"own_plans": {"a": PLAN}}, "z": 1}
    assert yaml.safe_load(with_value(text, "own_plans", "a", None, within="placement"))["z"] == 1
