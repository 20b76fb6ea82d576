import re
from collections import Counter
from pathlib import Path

import pytest

from roadsight.io.records.sources import stage_module
from scripts.rooms import BESIDE, FLOORS, PACKAGE, WORKFLOW, allowed, floor_of, imports
from tests.conftest import PROJECT

MOST_FILES = 24
CHAPTERS = ("scene", "placement", "poles", "evidence")
RULES = PROJECT / "workflow" / "rules"


def test_imports_run_down():
    up = {(file, other) for file, room, other in imports() if other not in allowed(room)}
    assert not up, "\n".join(f"{file} imports {other}" for file, other in sorted(up))


def test_every_folder_of_the_package_is_a_room_and_every_room_is_there():
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    assert all((WORKFLOW / name / "__init__.py").is_file() for name in BESIDE)
    folders |= {name.removeprefix("roadsight_") for name in BESIDE}
    assert folders == {room for rooms in FLOORS for room in rooms}


def test_an_arrow_that_runs_up_is_noticed():
    assert "evidence" not in allowed("io")
    assert allowed("setcover") == {"base", "setcover"}
    with pytest.raises(KeyError, match="no room"):
        floor_of("attic")


@pytest.mark.parametrize("root", ["workflow", "tests"])
def test_no_folder_is_a_crowd(root: str):
    files = [path for path in (PROJECT / root).rglob("*") if path.is_file()]
    shown = [path for path in files if "__pycache__" not in path.parts]
    crowd = Counter(path.parent for path in shown if path.name != "__init__.py")
    assert {str(f): n for f, n in crowd.items() if n > MOST_FILES} == {}


def test_a_rule_and_its_stage_are_in_the_same_chapter():
    for file in sorted(RULES.rglob("*.smk")):
        text = file.read_text(encoding="utf-8")
        for module in re.findall(r"python -m (roadsight\.stages\.[\w.]+)", text):
            stem = module.rpartition(".")[2]
            assert stage_module(stem) == module
            assert module == f"roadsight.stages.{file.parent.name}.{stem}", file
            assert re.search(rf"^(rule|checkpoint) {stem}:", text, re.M), f"{file}: {module}"


def test_chapters_have_the_same_names_everywhere():
    for folder in (RULES, PACKAGE / "stages", PROJECT / "docs", PROJECT / "tests" / "unit"):
        present = {path.name for path in folder.iterdir() if path.is_dir()}
        assert set(CHAPTERS) <= present, folder


def test_stems_of_stages_are_unique():
    stems = Counter(
        path.stem
        for chapter in CHAPTERS
        for path in Path(PACKAGE / "stages" / chapter).glob("*.py")
        if path.stem != "__init__"
    )
    assert max(stems.values()) == 1
