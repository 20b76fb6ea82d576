import json

import numpy as np
import pytest
from scipy import sparse

from roadsight.__main__ import main
from roadsight.base.errors import InputError
from roadsight.io.records.matrices import read_element_list, read_matrix, read_set_list, read_vector

MATRIX = sparse.csr_matrix([[1, 1, 0], [0, 1, 1], [0, 0, 1]])


@pytest.fixture
def matrix(tmp_path):
    sparse.save_npz(tmp_path / "a.npz", MATRIX)
    return tmp_path / "a.npz"


def test_reads_any_sparse_layout(tmp_path):
    for layout in ("csr", "csc", "coo"):
        sparse.save_npz(tmp_path / "m.npz", MATRIX.asformat(layout))
        assert (read_matrix(tmp_path / "m.npz") != MATRIX).nnz == 0


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_refuses_entries(tmp_path, value):
    sparse.save_npz(tmp_path / "m.npz", sparse.csr_matrix([[1.0, value]]))
    with pytest.raises(InputError, match="negative or not finite"):
        read_matrix(tmp_path / "m.npz")


def test_refuses_what_is_no_matrix(tmp_path):
    with pytest.raises(InputError, match="no file"):
        read_matrix(tmp_path / "missing.npz")
    (tmp_path / "m.npz").write_bytes(b"PK no archive")
    with pytest.raises(InputError, match="cannot be read"):
        read_matrix(tmp_path / "m.npz")
    np.savez(tmp_path / "d.npz", a=np.ones(3))
    with pytest.raises(InputError, match="cannot be read"):
        read_matrix(tmp_path / "d.npz")
    sparse.save_npz(tmp_path / "v.npz", sparse.coo_array(np.ones(3)))
    with pytest.raises(InputError, match="1-D"):
        read_matrix(tmp_path / "v.npz")


def test_vector(tmp_path):
    np.save(tmp_path / "c.npy", [1.0, 2.0])
    assert read_vector(tmp_path / "c.npy").tolist() == [1.0, 2.0]
    for bad in (np.ones((2, 2)), np.array(["a"])):
        np.save(tmp_path / "b.npy", bad)
        with pytest.raises(InputError):
            read_vector(tmp_path / "b.npy")


def test_text_formats_agree(tmp_path):
    (tmp_path / "s.txt").write_text("3 2\n5 0 2\n7 1\n")
    matrix, costs = read_set_list(tmp_path / "s.txt")
    assert costs.tolist() == [5, 7]
    (tmp_path / "e.txt").write_text("3 2\n0\n1\n0\n1\n1\n1\n2\n1\n0\n")
    assert (read_element_list(tmp_path / "e.txt") != matrix).nnz == 0
    assert matrix.toarray().tolist() == [[1, 0, 1], [0, 1, 0]]


@pytest.mark.parametrize(
    "text", ["", "3\n", "3 2\n5 0\n", "3 1\n5 3\n", "3 1\n5 x\n", "3 1\n5 -1\n"]
)
def test_refuses_set_list(tmp_path, text):
    (tmp_path / "s.txt").write_text(text)
    with pytest.raises(InputError):
        read_set_list(tmp_path / "s.txt")


@pytest.mark.parametrize(
    "text", ["1", "1 1 0 2 0", "1 1 0 1 1", "1 1 1 1 0", "1 1 0 1 0 9", "1 1 0 -1"]
)
def test_refuses_element_list(tmp_path, text):
    (tmp_path / "e.txt").write_text(text)
    with pytest.raises(InputError):
        read_element_list(tmp_path / "e.txt")


def test_verb_writes_a_proven_cover(matrix, tmp_path, capsys):
    out = tmp_path / "s.json"
    assert main(["cover", str(matrix), "-o", str(out)]) == 0
    content = json.loads(out.read_text())
    assert content["status"] == "optimal"
    assert (content["objective"], content["bound"], content["gap"]) == (2.0, 2.0, 0.0)
    assert content["chosen"] == [0, 1]
    assert content["seconds_cpu"] >= 0
    assert "2 rows, cost 2" in capsys.readouterr().out


def test_verb_takes_costs_and_groups(matrix, tmp_path):
    np.save(tmp_path / "c.npy", [1.0, 5.0, 1.0])
    np.save(tmp_path / "g.npy", [0, -1, 0])
    out = tmp_path / "s.json"
    files = ["--costs", str(tmp_path / "c.npy"), "--groups", str(tmp_path / "g.npy")]
    assert main(["cover", str(matrix), *files, "-o", str(out)]) == 0
    assert json.loads(out.read_text())["chosen"] == [0, 1]


def test_verb_spends_a_budget(matrix, tmp_path, capsys):
    out = tmp_path / "s.json"
    assert main(["cover", str(matrix), "--budget", "1", "-o", str(out)]) == 0
    assert json.loads(out.read_text())["objective"] == 2
    assert "2 of 3 targets covered" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at-least", "2"], "1 of 3 targets cannot be covered 2 times: columns 0"),
        (["--at-least", "0"], "too small"),
        (["--time-limit", "nan"], "no time"),
        (["--seed", "-1"], "negative"),
        (["--budget", "nan"], "budget"),
    ],
)
def test_verb_refuses_and_writes_nothing(matrix, tmp_path, capsys, arguments, message):
    out = tmp_path / "s.json"
    code = main(["cover", str(matrix), *arguments, "-o", str(out)])
    assert message in capsys.readouterr().err
    assert code == 2
    assert not out.exists()
