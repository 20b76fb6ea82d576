"""Files of earlier versions are told what their settings are called now."""

from __future__ import annotations

from functools import reduce
from pathlib import Path
from typing import Any, get_args

import pytest

from roadsight.base.errors import InputError
from roadsight.base.former import RENAMED, RENAMED_VALUES
from roadsight.config.load import load_config, resolve_site
from roadsight.config.schema import Config
from roadsight.effects.catalogue import load_catalogue

FORMER = [(old, "use", new) for old, new in RENAMED.items()] + [
    (path, old, new) for path, words in RENAMED_VALUES.items() for old, new in words.items()
]


def nested(path: str, value: object) -> dict[str, Any]:
    return reduce(lambda inside, key: {key: inside}, reversed(path.split(".")), value)


@pytest.mark.parametrize(("path", "value", "new"), FORMER)
def test_a_former_name_is_told_its_new_one(path, value, new):
    with pytest.raises(InputError, match=f"renamed to {new}"):
        load_config(nested(path, value))
    site = {"site": "old", "jobs": ["scene"], "clouds": ["a.laz"], "settings": nested(path, value)}
    with pytest.raises(InputError, match=f"old.yaml: settings.*renamed to {new}"):
        resolve_site(site, Path("old.yaml"), Config())
    with pytest.raises(InputError, match=f"renamed to {new}"):
        site["settings"] = {}
        resolve_site(site, Path("old.yaml"), Config(overrides=nested(path, value)))


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_new_names_are_settings_and_former_ones_are_not(old, new):
    section, _, name = new.rpartition(".")
    if section == "effects":
        assert name in load_catalogue(Config().effects_file)
    else:
        assert name in type(getattr(Config(), section)).model_fields
    with pytest.raises(InputError):
        load_config(nested(old, "use"))


@pytest.mark.parametrize("path", RENAMED_VALUES)
def test_new_words_are_values_of_the_setting_and_former_ones_are_not(path):
    section, name = path.split(".")
    words = get_args(type(getattr(Config(), section)).model_fields[name].annotation)
    assert set(RENAMED_VALUES[path].values()) <= set(words)
    assert not set(RENAMED_VALUES[path]) & set(words)


def test_an_unknown_key_without_a_former_name_is_told_the_nearest():
    with pytest.raises(InputError, match=r"unknown key 'alignment.methd'; did you mean 'method'"):
        load_config({"alignment": {"methd": "road"}})
