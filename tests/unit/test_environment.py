"""The environment in which stages run."""

from __future__ import annotations

import py_compile

from roadsight.config.environment import drop_damaged_bytecode


def test_only_bytecode_that_cannot_be_loaded_is_removed(tmp_path):
    whole, cut = tmp_path / "whole.py", tmp_path / "cut.py"
    for path in (whole, cut):
        path.write_text("VALUE = [1, 2, 3]\n" * 50)
        py_compile.compile(str(path))
    compiled = {path.name.split(".")[0]: path for path in tmp_path.rglob("*.pyc")}
    compiled["cut"].write_bytes(compiled["cut"].read_bytes()[:40])
    drop_damaged_bytecode(tmp_path)
    assert [path.name for path in tmp_path.rglob("*.pyc")] == [compiled["whole"].name]
