import argparse
import dataclasses
import importlib
import inspect
import json
import pkgutil
import re
import shlex
import subprocess
import sys
from typing import Annotated, get_args, get_origin, get_type_hints

import pytest
from pydantic_core import PydanticUndefined

import roadsight
from roadsight.base.options import add_settings
from roadsight.base.section import Section
from roadsight.base.sections.placement import Cover
from roadsight.base.sections.poles import Voxels
from roadsight.base.sections.scene import Pavement
from roadsight.config.schema import Settings
from roadsight.io.records.sources import stage_module
from tests.conftest import PROJECT

TARGETS = ("all", "audit", "hardcases", "paper", "paper_long", "tradeoffs", "truth")

OTHER = {"shards", "mounting", "reach_m"}
"""Without shards a stage does the whole; rules of mounting as JSON; of truth, not of poles."""


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


@pytest.fixture(scope="module")
def commands() -> dict[str, list[list[str]]]:
    """Arguments of all steps of all sites by the module of their stage, from a dry-run."""
    listed = ""
    for line in (TARGETS, ("--configfile", "config/published.yaml")):
        listed += subprocess.run(
            [sys.executable, "-m", "snakemake", "-n", "-p", "--forceall", "--nolock", *line],
            cwd=PROJECT, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
    found: dict[str, list[list[str]]] = {}
    for module, rest in re.findall(r"python -m (roadsight\.stages\S+) (.*?) > \S+ 2>&1", listed):
        # A decision that waits for a profile stands as "open" until its step runs.
        known = re.sub(r"=open\b", "=skip", rest).replace(" open ", " ")
        found.setdefault(module, []).append(shlex.split(known))
    return found


def told(commands: list[list[str]]) -> set[str]:
    """Names that any of a stage's commands gives a value."""
    options = {part.partition("=")[0] for line in commands for part in line if part[:2] == "--"}
    return {option[2:].replace("-", "_") for option in options}


def text_of_helpers() -> str:
    """Helpers of rules: options of plans that hold with tolerance are not in every dry-run."""
    texts = [file.read_text("utf-8") for file in (PROJECT / "workflow").rglob("*_inputs.smk")]
    tolerance = " ".join(f"--{name}" for name in sections()["tolerance"])
    return re.sub(r"[^\w-]--", " --", "".join(texts)) + tolerance


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


def test_every_rule_and_its_stage_have_the_same_names(commands):
    """The stage takes what its rule names, and lacks nothing."""
    for module, lines in commands.items():
        parser = importlib.import_module(module).main.parser()
        for line in lines:
            parser.parse_args(line)


LISTED = """
import json
from pathlib import Path
from snakemake.api import SnakemakeApi
from snakemake.settings.types import OutputSettings, ResourceSettings

with SnakemakeApi(OutputSettings()) as api:
    opened = api.workflow(resource_settings=ResourceSettings(), snakefile=Path("Snakefile"))
    loaded = opened._workflow
    awaited = loaded.globals["AWAITED"]
    names = {
        rule.name: [
            *(n for n in rule.input.keys() if n not in awaited and not n.endswith("_files")),
            *rule.output.keys(),
        ]
        for rule in loaded.rules
        if "code" in rule.input.keys()
    }
print(json.dumps(names))
"""


def test_a_stage_takes_every_input_and_output_of_its_rule():
    """Also those that no site of the dry-runs has, as lists that a user gives."""
    done = subprocess.run(
        [sys.executable, "-c", LISTED], cwd=PROJECT, capture_output=True, text=True, check=True
    )
    rules = json.loads(done.stdout.splitlines()[-1])
    unknown = {}
    for rule, names in rules.items():
        parser = importlib.import_module(stage_module(rule)).main.parser()
        options = {option for action in parser._actions for option in action.option_strings}
        if missing := {f"--{name.replace('_', '-')}" for name in names} - options:
            unknown[rule] = missing
    assert len(rules) >= 80
    assert not unknown


def test_no_stage_writes_the_default_of_a_setting_again(commands):
    named = {name for values in sections().values() for name in values}
    twice = {}
    for module, lines in commands.items():
        parameters = parameters_of(importlib.import_module(module).main.stage)
        nothing = (inspect._empty, None, "", ())
        own = {name for name, (_, default) in parameters.items() if default not in nothing}
        if repeated := named & told(lines) & own - OTHER:
            twice[module] = repeated
    assert not twice


def test_rules_hand_on_each_setting_that_their_stage_takes(commands):
    """Else a default would decide whose change makes nothing stale."""
    lacking = {}
    for module, lines in commands.items():
        missing = settings_of(importlib.import_module(module).main.stage) - told(lines)
        if missing - told([text_of_helpers().split()]):
            lacking[module] = missing
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


def test_the_walk_finds_what_it_is_about(commands):
    assert len(commands) >= 60 and sum(len(told(lines)) for lines in commands.values()) >= 600
    assert len(sections()) >= 25
