import os
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from roadsight.io.records.sources import CachedChecksums

RULES = Path(__file__).parents[4] / "workflow/rules/poles/videolog_inputs.smk"


@pytest.fixture
def told(tmp_path):
    """Option of a site whose masks and depths come of given manifests; none: the project's own."""

    def option(masks=None, depth=None):
        sources = [SimpleNamespace(files=[str(masks)])] if masks else []
        model = SimpleNamespace(model=str(depth), images=None) if depth else None
        poles = SimpleNamespace(masks=sources, depth=model)
        resolved = SimpleNamespace(site=SimpleNamespace(poles=poles, sample=None), beside=str)
        rules = {
            "SITES": {"a": resolved},
            "CHECKSUMS": CachedChecksums(tmp_path / "checksums.json"),
            "clearly": lambda function, *arguments: function(*arguments),
            "lru_cache": lru_cache,
            "os": os,
            "Path": Path,
        }
        exec(compile(RULES.read_text("utf-8"), str(RULES), "exec"), rules)
        return rules["own_networks"](SimpleNamespace(site="a"))

    return option


def manifest(folder, network):
    folder.mkdir()
    (folder / "copy.onnx").write_bytes(network)
    (folder / "mine.yaml").write_text(yaml.safe_dump({"task": "classes", "file": "copy.onnx"}))
    return folder / "mine.yaml"


def test_a_copy_of_the_project_s_network_is_its_own_and_another_is_not(told, tmp_path):
    shipped = RULES.parents[3] / "resources/models/road_classes.onnx"
    copy = manifest(tmp_path / "copy", shipped.read_bytes())
    other = manifest(tmp_path / "other", b"another network")
    assert told() == "--own-networks classes depth"
    assert told(masks=copy) == "--own-networks classes depth"
    assert told(masks=other) == "--own-networks depth"
    assert told(masks=other, depth=other) == ""
    assert told(masks=other, depth=copy) == "--own-networks classes"
