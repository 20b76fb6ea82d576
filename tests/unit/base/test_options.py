"""Command lines of typed functions."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from roadsight.base.options import add_options
from roadsight.base.section import Section
from roadsight.stages.command import Command

NEEDED = ["a.laz", "b.laz", "--frame", "f.json", "--frames", "t.parquet", "-o", "o.json"]


class Grid(Section):
    """Settings that a stage takes as one."""

    cell_m: float = Field(default=2.0, gt=0, description="width of a cell, m")
    kinds: list[str] = Field(default=["pole"], description="what is looked for")


class Lamp(Section):
    """Settings of which a stage takes one."""

    height_m: float = Field(default=8.0, description="above the road, m")
    power_w: float = Field(default=60.0, description="of the lamp, W")


@dataclass(frozen=True)
class Tables:
    """Files that belong together."""

    frames: Path
    shards: Sequence[Path] = ()


@pytest.fixture
def run():
    """Run a stage on options; gives what its parameters were, or the exit code."""
    calls = []

    def stage(
        clouds: Sequence[Path],
        /,
        frame_path: Annotated[Path, "of 100 % of the points"],
        settings: Grid,
        tables: Tables,
        height_m: Annotated[float, Lamp],
        given_json: str = "{}",
        side: Literal["left", "right"] = "left",
        crs: str | None = None,
        at: tuple[float, float] | None = None,
        sure: bool = False,
        pairs: tuple[Sequence[str], ...] = (),
        *,
        out: Path,
    ) -> None:
        calls.append({name: value for name, value in locals().items() if name != "calls"})

    # What the annotations name is found in the module, as that of a stage is.
    command = Command(stage)

    def call(*options):
        code = command([*NEEDED, *options])
        return calls.pop() if code == 0 else code

    call.command = command
    return call


def test_parameters_become_options_of_their_type(run):
    usual = run()
    assert usual["clouds"] == (Path("a.laz"), Path("b.laz"))
    assert (usual["frame_path"], usual["out"]) == (Path("f.json"), Path("o.json"))
    assert (usual["given_json"], usual["side"], usual["crs"]) == ("{}", "left", None)
    assert (usual["at"], usual["sure"]) == (None, False)
    said = run("--given", "[]", "--side", "right", "--crs", "EPSG:1", "--at", "1", "2.5", "--sure")
    assert (said["given_json"], said["side"], said["crs"]) == ("[]", "right", "EPSG:1")
    assert (said["at"], said["sure"]) == ((1.0, 2.5), True)


def test_a_tuple_of_any_length_may_be_repeated(run):
    assert run()["pairs"] == ()
    assert run("--pairs", "a", "b", "--pairs", "c")["pairs"] == (["a", "b"], ["c"])


def test_sections_and_dataclasses_become_objects(run):
    usual = run()
    assert usual["settings"] == Grid() and usual["tables"] == Tables(Path("t.parquet"))
    assert usual["height_m"] == Lamp().height_m
    said = run("--cell-m", "0.5", "--kinds", "a", "b", "--shards", "1", "2", "--height-m", "3")
    assert said["settings"] == Grid(cell_m=0.5, kinds=["a", "b"])
    assert said["tables"].shards == (Path("1"), Path("2")) and said["height_m"] == 3.0


@pytest.mark.parametrize("nothing", [["--crs"], ["--crs", ""]])
def test_a_value_that_may_lack_is_none(run, nothing):
    assert run(*nothing)["crs"] is None


def test_settings_out_of_range_are_bad_input(run, capsys):
    assert run("--cell-m", "-1") == 2
    assert "cell_m" in capsys.readouterr().err


@pytest.mark.parametrize("wrong", [["--side", "up"], ["--power-w", "1"], ["--at", "1"]])
def test_what_no_parameter_takes_is_refused(run, wrong):
    with pytest.raises(SystemExit):
        run(*wrong)


def test_help_is_that_of_parameters_and_settings(run):
    text = run.command.parser().format_help()
    assert "of 100 % of the points" in text and "width of a cell, m" in text
    assert "Command lines of typed functions." in text


def test_what_must_be_given_is_asked_for(run, capsys):
    with pytest.raises(SystemExit):
        run.command(["--frame", "f.json"])
    message = capsys.readouterr().err
    assert all(name in message for name in ("CLOUDS", "--frames", "--out"))
    assert "--shards" not in message.rpartition("required")[2]


@pytest.mark.parametrize("forgotten", ["--crs", "--shards", "--kinds", "--cell-m"])
def test_a_value_that_a_person_forgets_is_asked_for(forgotten, capsys):
    def verb(
        settings: Grid, tables: Tables, crs: str | None = None, spacing_m: float | None = None
    ) -> None:
        """Take what may lack in a rule."""

    parser = argparse.ArgumentParser()
    add_options(parser, verb, may_lack=False)
    assert parser.parse_args(["--frames", "t", "--crs", "local"]).crs == "local"
    with pytest.raises(SystemExit):
        parser.parse_args(["--frames", "t", forgotten])
    assert "expected" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        parser.parse_args(["--frames", "t", "--spacing-m", "far"])
    assert "invalid float value: 'far'" in capsys.readouterr().err
