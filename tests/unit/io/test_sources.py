import ast
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from roadsight.base.sections.scene import PavementOutline
from roadsight.io.records import sources
from roadsight.io.records.sources import Stamps


def stage_sources(stage):
    return [str(path) for path in sources._Sources().of(stage)]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package in which stage ``one`` reaches ``deep`` through two imports."""
    content = {
        "roadsight/__init__.py": "",
        "roadsight/stages/__init__.py": "",
        "roadsight/stages/scene/__init__.py": "",
        "roadsight/stages/scene/one.py": "import numpy\n"
        "from roadsight.core import near, CONSTANT\n",
        "roadsight/stages/scene/two.py": "import roadsight.other\n",
        "roadsight/core/__init__.py": "from roadsight.core.constants import CONSTANT\n",
        "roadsight/core/constants.py": "CONSTANT = 1\n",
        "roadsight/core/near.py": "def f():\n    from roadsight.core.deep import g\n    return g\n",
        "roadsight/core/deep.py": "import roadsight.core.near\n\n\ndef g():\n    return 1\n",
        "roadsight/core/unused.py": "",
        "roadsight/other.py": "",
        "elsewhere/roadsightish.py": "",
    }
    for name, text in content.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(sources, "_PACKAGE_ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)


def test_transitive_lazy_and_package_imports_are_found_and_others_are_not(package):
    assert stage_sources("one") == [
        "roadsight/__init__.py", "roadsight/core/__init__.py", "roadsight/core/constants.py",
        "roadsight/core/deep.py", "roadsight/core/near.py", "roadsight/stages/__init__.py",
        "roadsight/stages/scene/__init__.py", "roadsight/stages/scene/one.py",
    ]  # fmt: skip


def test_another_stage_has_its_own_sources(package):
    found = stage_sources("two")
    assert "roadsight/other.py" in found
    assert not [name for name in found if "core" in name]


def test_nothing_is_imported_to_find_out(package, tmp_path):
    (tmp_path / "roadsight/stages/scene/three.py").write_text("raise SystemExit('imported')\n")
    assert "roadsight/stages/scene/three.py" in stage_sources("three")


def test_paths_are_relative_to_the_work_folder(package, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert "../roadsight/stages/scene/one.py" in stage_sources("one")


def test_ground_stage_depends_on_the_ground_filter_and_not_on_fpfh(project, monkeypatch):
    monkeypatch.chdir(project)
    found = stage_sources("build_dem")
    for name in ("stages/scene/build_dem", "scene/terrain/ground", "scene/grids", "base/errors"):
        assert f"workflow/roadsight/{name}.py" in found
    for name in ("scene/pavement/fpfh", "placement/candidates/candidates"):
        assert f"workflow/roadsight/{name}.py" not in found


def test_everything_that_python_imports_for_a_stage_is_listed(project, monkeypatch):
    monkeypatch.chdir(project)
    code = (
        "import sys, roadsight.stages.placement.place_candidates\n"
        "for name, module in sys.modules.items():\n"
        "    if name.partition('.')[0] == 'roadsight' and module.__file__: print(module.__file__)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = {Path(line).resolve() for line in run.stdout.split()}
    listed = {Path(name).resolve() for name in stage_sources("place_candidates")}
    # Settings reach a stage as params of its rule; tests/unit/config/test_one_truth.py.
    declared = {path for path in imported if path.parent.name == "sections"}
    assert len(imported) > 8 and declared
    assert imported - declared <= listed
    assert not declared & listed


class TestStamps:
    """A file stands for the sources of a stage."""

    @pytest.fixture
    def stamp(self, package, tmp_path):
        def made():
            return tmp_path / Stamps(Path("kept/stamps"), "elsewhere/roadsightish.py").of("one")

        return made

    def test_it_lists_what_the_stage_rests_on_and_is_as_old(self, stamp, tmp_path):
        for number, path in enumerate(sorted(tmp_path.rglob("*.py"))):
            os.utime(path, (1000 + number, 1000 + number))
        made = stamp()
        listed = [line.partition("  ")[2] for line in made.read_text().splitlines()]
        assert listed == [*stage_sources("one"), "elsewhere/roadsightish.py"]
        assert made.stat().st_mtime == max((tmp_path / name).stat().st_mtime for name in listed)
        before = made.stat()
        assert stamp().stat() == before

    def test_touching_changes_its_date_and_editing_its_content(self, stamp, tmp_path):
        made = stamp()
        before, deep = made.read_bytes(), tmp_path / "roadsight/core/deep.py"
        later = made.stat().st_mtime + 50
        os.utime(deep, (later, later))
        assert stamp().stat().st_mtime == later
        assert made.read_bytes() == before
        (tmp_path / "roadsight/core/unused.py").write_text("edited = True\n")
        assert stamp().read_bytes() == before
        deep.write_text("def g():\n    return 2\n")
        assert stamp().read_bytes() != before

    def test_a_default_of_a_section_that_a_source_names_changes_it(
        self, project, monkeypatch, tmp_path
    ):
        monkeypatch.chdir(project)

        def content():
            sources._defaults.cache_clear()
            return Path(Stamps(tmp_path / "stamps").of("extract_pavement")).read_text()

        before = content()
        assert "roadsight.base.sections.scene.PavementOutline\n" in before
        monkeypatch.setattr(PavementOutline.model_fields["closing_m"], "default", 9.0)
        changed = set(content().splitlines()) - set(before.splitlines())
        assert changed
        assert all("PavementOutline" in line or "Pavement" in line for line in changed)
        monkeypatch.setattr(PavementOutline.model_fields["closing_m"], "description", "other words")
        assert set(content().splitlines()) - set(before.splitlines()) == changed
        sources._defaults.cache_clear()

    def test_what_files_import_is_parsed_once(self, stamp, tmp_path, monkeypatch):
        stamp()
        parsed = []
        parse = sources._imports
        monkeypatch.setattr(sources, "_imports", lambda c: parsed.append(c) or parse(c))
        before = stamp().read_bytes()
        assert not parsed
        edited = tmp_path / "roadsight/core/near.py"
        edited.write_text("import roadsight.other  # edited\n")
        listed = stamp().read_text()
        assert len(parsed) == 1
        assert "roadsight/other.py" in listed and "roadsight/core/deep.py" not in listed
        kept = json.loads((tmp_path / "kept/imports.json").read_text())
        numbers = dict.fromkeys(kept["imports"], 3)
        for damage in ("[1", "[]", "{}", json.dumps(kept | {"imports": numbers})):
            (tmp_path / "kept/imports.json").write_text(damage)
            assert stamp().read_text() == listed
        edited.write_text("def f():\n    from roadsight.core.deep import g\n    return g\n")
        assert stamp().read_bytes() == before

    def test_another_parser_looks_again(self, stamp, tmp_path):
        listed = stamp().read_text()
        kept = json.loads((tmp_path / "kept/imports.json").read_text())
        nothing = {name: [] for name in kept["imports"]}
        for parser, same in ((kept["parser"], False), ("an older one", True)):
            memory = json.dumps({"parser": parser, "imports": nothing})
            (tmp_path / "kept/imports.json").write_text(memory)
            assert (stamp().read_text() == listed) is same

    def test_a_broken_file_matters_where_it_is_needed(self, stamp, tmp_path):
        listed = stamp().read_text()
        (tmp_path / "roadsight/core/unused.py").write_text("def f(:\n")
        (tmp_path / "roadsight/core/.#near.py").symlink_to("nowhere")
        assert stamp().read_text() == listed
        (tmp_path / "roadsight/core/near.py").write_text("def f(:\n")
        with pytest.raises(SyntaxError):
            stamp()

    def test_an_older_file_of_other_content_is_a_change_of_now(self, stamp, tmp_path):
        started = time.time()
        stamp()
        deep = tmp_path / "roadsight/core/deep.py"
        deep.write_text("def g():\n    return 2\n")
        os.utime(deep, (1000, 1000))
        assert stamp().stat().st_mtime >= started - 1


PLACES = [
    "if True:\n    pass\nelse:\n    {}", "try:\n    {}\nfinally:\n    pass",
    "try:\n    pass\nexcept OSError:\n    {}", "try:\n    pass\nfinally:\n    {}",
    "try:\n    pass\nexcept OSError:\n    pass\nelse:\n    {}",
    "for _ in ():\n    pass\nelse:\n    {}", "while False:\n    {}", "with open('x'):\n    {}",
    "class A:\n    def f(self):\n        {}", "async def f():\n    async with g():\n        {}",
    "match 1:\n    case 1:\n        {}",
]  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_imports_count_wherever_statements_stand(package, tmp_path, place):
    (tmp_path / "roadsight/stages/scene/four.py").write_text(place.format("import roadsight.other"))
    assert "roadsight/other.py" in stage_sources("four")


def test_as_many_imports_as_a_walk_over_all_nodes_finds(project):
    for path in (project / "workflow/roadsight").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        wanted, found = (
            {node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)}
            for nodes in (ast.walk(tree), sources._statements(tree))
        )
        assert wanted == found, path
