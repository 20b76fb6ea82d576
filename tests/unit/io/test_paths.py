from pathlib import Path

import numpy as np
import pytest
import yaml

from roadsight.base.errors import InputError
from roadsight.base.section import check_path
from roadsight.io.images.models import open_model
from tests.helpers.onnx_bytes import FLOAT, _number, _part, network, node, value


@pytest.mark.parametrize(
    "path", ["a" * 256, "é" * 128, "b/" * 2100, "{x}", "a\0b", f"deep/{'n' * 300}/file"]
)
def test_what_no_file_can_be_called(path):
    with pytest.raises(InputError, match=r"here: a path .*found") as error:
        check_path(Path(path), "here")
    assert len(str(error.value)) < 700


@pytest.mark.parametrize("path", ["a" * 255, "a b;$(c)'\n", "../x/-rf", "Straße.laz"])
def test_what_a_file_can_be_called(path):
    check_path(Path(path), "here")


def test_a_network_reads_no_file_outside_its_folder(tmp_path):
    """Weights may lie in a file of their own; its name comes from the network and must stay."""
    (tmp_path / "secret.bin").write_bytes(np.ones(9, np.float32).tobytes())
    folder = tmp_path / "models"
    folder.mkdir()
    for place in ("weights.bin", "../secret.bin", str(tmp_path / "secret.bin")):
        (folder / "weights.bin").write_bytes(np.ones(9, np.float32).tobytes())
        (folder / "net.onnx").write_bytes(_with_weights_in(place))
        (folder / "net.yaml").write_text(yaml.safe_dump(_MANIFEST))
        if place == "weights.bin":
            assert open_model(folder / "net.yaml").input_name == "image"
        else:
            with pytest.raises(InputError, match="cannot be opened as a network"):
                open_model(folder / "net.yaml")


_MANIFEST = {
    "task": "classes",
    "file": "net.onnx",
    "labels": 3,
    "classes": {0: "road", 2: "pole"},
    "input": {"colour": "RGB", "size": {"height_px": 8, "width_px": 12}},
    "output": {"kind": "logits"},
}


def _with_weights_in(place: str) -> bytes:
    """Network of `onnx_bytes.pointwise` whose weights are in another file."""
    entry = b"".join(_part(1, key) + _part(2, text) for key, text in (("location", place),))
    weights = b"".join(_number(1, n) for n in (3, 3, 1, 1)) + _number(2, FLOAT)
    weights += _part(8, "w") + _part(13, entry) + _number(14, 1)
    ends = [value("image", [1, 3, 8, 12])], [value("logits", [1, 3, 8, 12])]
    return network([node("Conv", ["image", "w"], "logits")], [weights], *ends)
