"""A default that is written in two places is the same in both."""

from __future__ import annotations

import argparse
import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re

import pytest
from pydantic_core import PydanticUndefined

import roadsight
from roadsight.base.options import add_settings
from roadsight.base.section import Section
from roadsight.config.schema import Settings
from roadsight.config.sections.placement import Cover
from roadsight.config.sections.poles import Voxels
from roadsight.config.sections.scene import Pavement
from tests.conftest import PROJECT

RULES = re.compile(
    r"^(?:rule|checkpoint) (\w+):\n(.*?)(?=^(?:rule|checkpoint|def|use|if) |\Z)", re.M | re.S
)
RULE = re.compile(r"^rule (\w+):\n(.*?)(?=^(?:rule|checkpoint|def|use) |\Z)", re.M | re.S)


def sections(model: type[Section] = Settings, prefix: str = "") -> dict[str, dict[str, object]]:
    """Defaults of each section of config.yaml, by its name."""
    found: dict[str, dict[str, object]] = {}
    for name, field in model.model_fields.items():
        kind = field.annotation
        if inspect.isclass(kind) and issubclass(kind, Section):
            found |= sections(kind, f"{prefix}{name}.")
        elif field.default is not PydanticUndefined:
            found.setdefault(prefix.rstrip("."), {})[name] = field.default
    return found


def parsers() -> list[tuple[str, str]]:
    """Stage and section of each rule that hands a section on as options."""
    pairs = set()
    for file in sorted((PROJECT / "workflow" / "rules").rglob("*.smk")):
        for _, body in RULE.findall(file.read_text("utf-8")):
            module = re.search(r"python -m (roadsight\.stages\.[\w.]+)", body)
            for section in re.findall(r'(?<!some_)flags\("([\w.]+)"', body):
                if module:
                    pairs.add((module.group(1), section))
    return sorted(pairs)


def asked() -> dict[str, set[str]]:
    """Settings that rules hand on one by one or by section, by the module of their stage."""
    found: dict[str, set[str]] = {}
    for file in sorted((PROJECT / "workflow" / "rules").rglob("*.smk")):
        for _, body in RULES.findall(file.read_text("utf-8")):
            module = re.search(r"python -m (roadsight\.stages\.[\w.]+)", body)
            if module:
                names = set(re.findall(r'setting\("[\w.]+\.(\w+)"\)', body))
                for section in re.findall(r'(?<!some_)flags\("([\w.]+)"', body):
                    names |= set(sections()[section])
                found.setdefault(module.group(1), set()).update(names)
    return found


def written(source: str) -> set[str]:
    """Options of a stage whose default is written as a literal."""
    found = set()
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and getattr(call.func, "attr", "") == "add_argument":
            literal = [
                keyword
                for keyword in call.keywords
                if keyword.arg == "default" and isinstance(keyword.value, ast.Constant | ast.List)
            ]
            if literal and isinstance(call.args[0], ast.Constant):
                found.add(str(call.args[0].value).lstrip("-").replace("-", "_"))
    return found


def test_no_stage_writes_the_default_of_a_setting_again():
    twice = {}
    for module, names in asked().items():
        source = inspect.getsource(importlib.import_module(module))
        if repeated := names & written(source):
            twice[module] = repeated
    assert not twice


def taken(source: str) -> set[str]:
    """Settings that a module makes options of, one by one or the whole section."""
    found = set()
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "add_settings":
            names = [a.value for a in call.args[2:] if isinstance(a, ast.Constant)]
            kind = ast.unparse(call.args[1]).rpartition(".")[2]
            whole = {
                name
                for field in Settings.model_fields.values()
                if getattr(field.annotation, "__name__", "") == kind
                for name in field.annotation.model_fields
            }
            found |= set(names) if len(call.args) > 2 else whole
    return found


def test_rules_hand_on_each_setting_that_their_stage_takes():
    """Else a default would decide whose change makes nothing stale."""
    lacking = {}
    for file in sorted((PROJECT / "workflow" / "rules").rglob("*.smk")):
        beside = "".join(part.read_text("utf-8") for part in file.parent.glob("*_inputs.smk"))
        for name, body in RULES.findall(file.read_text("utf-8")):
            module = re.search(r"python -m (roadsight\.stages\.[\w.]+)", body)
            if not module:
                continue
            options = taken(inspect.getsource(importlib.import_module(module.group(1))))
            for section in re.findall(r'flags\(\s*"([\w.]+)"', body):
                options -= set(sections()[section])
            missing = {
                o for o in options if not re.search(f"--{o.replace('_', '-')}[ =]", body + beside)
            }
            if missing:
                lacking[name] = missing
    assert not lacking


def test_sections_make_options():
    parser = argparse.ArgumentParser()
    add_settings(parser, Pavement, "method", "voxel_size_m", "sample")
    add_settings(parser, Voxels, "road_classes")
    add_settings(parser, Cover, "second_objective")
    usual = parser.parse_args([])
    assert usual.voxel_size_m == Pavement().voxel_size_m and usual.second_objective is True
    assert usual.road_classes == Voxels().road_classes
    given = ["--sample", "7", "--road-classes", "2", "11", "--second-objective", "False"]
    said = parser.parse_args([*given, "--method", "published"])
    assert (said.sample, said.road_classes, said.second_objective) == (7, [2, 11], False)
    assert said.method == "published"
    for wrong in (["--method", "best"], ["--sample", "x"], ["--second-objective", "maybe"]):
        with pytest.raises(SystemExit):
            parser.parse_args(wrong)
    with pytest.raises(TypeError, match="effects"):
        add_settings(parser, Settings, "effects")


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.parametrize(("module", "section"), parsers())
def test_options_of_stages_have_the_defaults_of_their_section(module, section, monkeypatch):
    stage, caught = importlib.import_module(module), []
    monkeypatch.setattr(stage, "run_stage", lambda parser, *_: caught.append(parser) or 0)
    stage.main([])
    defaults = {action.dest: action.default for action in caught[0]._actions}
    wanted = sections()[section]
    drifted = {
        name: (defaults[name], value)
        for name, value in wanted.items()
        if defaults.get(name) is not None and defaults[name] != value
    }
    assert not drifted, "option, then config.yaml"


def test_settings_of_the_science_have_the_defaults_of_their_section():
    drifted = {}
    for found in pkgutil.walk_packages(roadsight.__path__, "roadsight."):
        if not found.name.startswith(("roadsight.scene", "roadsight.poles", "roadsight.placement")):
            continue
        for name, kind in vars(importlib.import_module(found.name)).items():
            own = dataclasses.is_dataclass(kind) and getattr(kind, "__module__", "") == found.name
            if not (own and name.endswith(("Settings", "Reach"))):
                continue
            have = {
                field.name: field.default
                for field in dataclasses.fields(kind)
                if field.default is not dataclasses.MISSING
            }
            for section, values in sections().items():
                common = set(have) & set(values)
                if len(common) >= max(2, len(have) // 3):
                    drifted |= {
                        f"{name}.{key}, {section}": (have[key], values[key])
                        for key in common
                        if _plain(have[key]) != _plain(values[key])
                    }
    # Of cameras that GPS alone placed, as the verb takes them; the workflow's are aligned.
    for name in ("sigma_position_m", "pole_evidence"):
        drifted.pop(f"TriangulationSettings.{name}, triangulation")
    assert not drifted, "science, then config.yaml"


def test_the_walk_finds_what_it_is_about():
    assert len(parsers()) >= 15
    assert len(sections()) >= 25
