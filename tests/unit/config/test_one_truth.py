"""A setting and its default are written once: in its section."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import pkgutil
import re
from typing import Annotated, get_args, get_origin, get_type_hints

import pytest
from pydantic_core import PydanticUndefined

import roadsight
import roadsight.base.sections as chapters
from roadsight.base.options import add_settings
from roadsight.base.section import Section
from roadsight.base.sections.placement import Cover
from roadsight.base.sections.poles import Voxels
from roadsight.base.sections.run import Sample
from roadsight.base.sections.scene import Pavement
from roadsight.config.schema import Settings
from tests.conftest import PROJECT

RULES = re.compile(
    r"^(?:rule|checkpoint) (\w+):\n(.*?)(?=^(?:rule|checkpoint|def|use|if) |\Z)", re.M | re.S
)


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


SECTIONS = {
    name: kind
    for found in pkgutil.iter_modules(chapters.__path__, f"{chapters.__name__}.")
    for name, kind in vars(importlib.import_module(found.name)).items()
    if inspect.isclass(kind) and issubclass(kind, Section)
}
"""All sections and their parts, by name."""


def handed_on(rule: str) -> set[str]:
    """Settings that a rule hands on together, by `flags`, `some_flags` and `sample_flags`."""
    found: set[str] = set()
    for kind, arguments in re.findall(r"(\w*flags)\(([^()]*)\)", rule):
        asked = list(eval(f"[{arguments}]", dict(SECTIONS)))
        whole = set(Sample.model_fields if kind == "sample_flags" else sections()[asked.pop(0)])
        parts = [[part] if isinstance(part, str) else part.model_fields for part in asked]
        names = {name for part in parts for name in part}
        assert names <= whole
        found |= whole if kind == "flags" else names
    return found


def asked() -> dict[str, set[str]]:
    """Settings that rules hand on one by one or by section, by the module of their stage."""
    found: dict[str, set[str]] = {}
    for file in sorted((PROJECT / "workflow" / "rules").rglob("*.smk")):
        for _, body in RULES.findall(file.read_text("utf-8")):
            module = re.search(r"python -m (roadsight\.stages\.[\w.]+)", body)
            if module:
                names = set(re.findall(r'setting\("(?:[\w.]+\.)?(\w+)"\)', body)) | handed_on(body)
                found.setdefault(module.group(1), set()).update(names)
    return found


def parameters_of(function: object) -> dict[str, tuple[object, object]]:
    """Type and default of the parameters of a typed function, and of the dataclasses it takes."""
    kinds = get_type_hints(function, include_extras=True)
    found = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if dataclasses.is_dataclass(kinds[name]):
            found |= parameters_of(kinds[name])
        else:
            found[name] = kinds[name], parameter.default
    return found


def settings_of(function: object) -> set[str]:
    """Settings that a typed function takes, one by one or as a section."""
    found = set()
    for name, (kind, _) in parameters_of(function).items():
        told = get_args(kind)[1:] if get_origin(kind) is Annotated else ()
        if any(isinstance(part, type) and issubclass(part, Section) for part in told):
            found.add(name)
        elif isinstance(kind, type) and issubclass(kind, Section):
            found |= set(kind.model_fields)
    return found


def test_no_stage_writes_the_default_of_a_setting_again():
    twice = {}
    for module, names in asked().items():
        parameters = parameters_of(importlib.import_module(module).main.stage)
        own = {name for name, (_, default) in parameters.items() if default != inspect._empty}
        # Without shards a stage does the whole.
        if repeated := names & own - {"shards"}:
            twice[module] = repeated
    assert not twice


def test_rules_hand_on_each_setting_that_their_stage_takes():
    """Else a default would decide whose change makes nothing stale."""
    lacking = {}
    for file in sorted((PROJECT / "workflow" / "rules").rglob("*.smk")):
        beside = "".join(part.read_text("utf-8") for part in file.parent.glob("*_inputs.smk"))
        for name, body in RULES.findall(file.read_text("utf-8")):
            module = re.search(r"python -m (roadsight\.stages\.[\w.]+)", body)
            if not module:
                continue
            options = settings_of(importlib.import_module(module.group(1)).main.stage)
            handed = handed_on(body)
            one_by_one = set(re.findall(r"--([\w-]+)[ =]", body + beside))
            left = options - handed - handed_on(beside)
            missing = {o for o in left if o.replace("_", "-") not in one_by_one}
            if missing or handed - options:
                lacking[name] = missing, handed - options
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


def test_no_dataclass_of_the_science_repeats_a_section():
    repeated = {}
    for found in pkgutil.walk_packages(roadsight.__path__, "roadsight."):
        if not found.name.startswith(("roadsight.scene", "roadsight.poles", "roadsight.placement")):
            continue
        for name, kind in vars(importlib.import_module(found.name)).items():
            if not (dataclasses.is_dataclass(kind) and name.endswith(("Settings", "Reach"))):
                continue
            have = {field.name for field in dataclasses.fields(kind)}
            for section, values in sections().items():
                if len(common := have & set(values)) >= max(2, len(have) // 3):
                    repeated[f"{name}, {section}"] = common
    assert not repeated


def test_the_walk_finds_what_it_is_about():
    assert len(asked()) >= 40 and sum(map(len, asked().values())) >= 150
    assert len(sections()) >= 25
