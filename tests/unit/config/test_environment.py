import os
import py_compile
import subprocess
import sys

from roadsight.config.environment import drop_damaged_bytecode, prepare_environment

_PAGES = """
import resource
import numpy as np
def new_pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(1_000_000, np.float32) for _ in range(40)]
    after = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    return (after - before) * resource.getpagesize() / sum(array.nbytes for array in arrays)
new_pages()
print(new_pages())
"""


def test_only_bytecode_that_cannot_be_loaded_is_removed(tmp_path):
    whole, cut = tmp_path / "whole.py", tmp_path / "cut.py"
    for path in (whole, cut):
        path.write_text("VALUE = [1, 2, 3]\n" * 50)
        py_compile.compile(str(path))
    compiled = {path.name.split(".")[0]: path for path in tmp_path.rglob("*.pyc")}
    compiled["cut"].write_bytes(compiled["cut"].read_bytes()[:40])
    drop_damaged_bytecode(tmp_path)
    assert [path.name for path in tmp_path.rglob("*.pyc")] == [compiled["whole"].name]


def test_stages_reuse_memory_that_they_have_had(monkeypatch):
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    prepare_environment()
    assert os.environ["OMP_NUM_THREADS"] == "2"  # what a user has set stays
    found = subprocess.run(
        [sys.executable, "-c", _PAGES], env=os.environ, stdout=subprocess.PIPE, check=True
    )
    assert float(found.stdout) < 0.1  # share of an array that is in new pages
