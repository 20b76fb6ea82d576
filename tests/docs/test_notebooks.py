"""The example notebooks run, from their first cell to the last, and say what they should."""

import json
import re

import pytest

from tests.conftest import PROJECT


def run(name, capsys):
    """What the cells of a notebook print."""
    cells = json.loads((PROJECT / "examples" / f"{name}.ipynb").read_text("utf-8"))["cells"]
    known = {}
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "notebooks are stored without outputs"
            exec(compile("".join(cell["source"]), f"{name}, cell {number}", "exec"), known)
    return known, capsys.readouterr().out


@pytest.mark.full
def test_the_placement_notebook_proves_its_cover(capsys):
    known, said = run("placement", capsys)
    assert re.search(r"optimal \[.*\] (\d) sensors, bound \1", said), said
    assert (known["sees"][known["best"].chosen].sum(axis=0) >= 1).all()
    assert known["twice"].status == "optimal"
    assert known["twice"].objective > known["best"].objective


def test_the_poles_notebook_finds_its_poles(capsys):
    known, said = run("poles", capsys)
    assert len(known["found"]) == 10, said
    assert known["errors_m"].mean() < 1.0
    assert "core-hours" in said


@pytest.mark.parametrize("name", ["placement", "poles"])
def test_notebooks_name_no_file_of_a_machine(name):
    text = (PROJECT / "examples" / f"{name}.ipynb").read_text("utf-8")
    assert "/home" not in text and "/work" not in text
