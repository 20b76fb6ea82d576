"""The Python of the how-to page runs as it stands."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import PROJECT
from tests.helpers.las_files import write_las

PAGE = PROJECT / "docs" / "howto" / "from-python.md"
_SNIPPET = re.compile(r"```python\n(.*?)```", re.DOTALL)


@pytest.mark.full
def test_what_the_page_shows_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
):
    (tmp_path / "config").mkdir()
    shutil.copy(PROJECT / "config" / "sensors.yaml", tmp_path / "config")
    xy = rng.uniform(0.0, 60.0, (60_000, 2))
    height = np.where(xy[:, 0] > 50.0, 6.0, 0.0) + rng.normal(0.0, 0.01, len(xy))
    corner = np.array([5e5, 5e6, 100.0])
    write_las(tmp_path / "street.laz", np.column_stack([xy, height]) + corner)
    monkeypatch.chdir(tmp_path)
    snippets = _SNIPPET.findall(PAGE.read_text("utf-8"))
    assert len(snippets) == 3
    names: dict[str, object] = {}
    for snippet in snippets:
        exec(compile(snippet, str(PAGE), "exec"), names)
    assert np.asarray(names["ground"]).mean() > 0.5
    assert names["cover"].bound <= len(names["cover"].chosen)
    assert names["pulp"].value(names["model"].objective) == names["cover"].bound
