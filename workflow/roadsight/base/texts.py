"""YAML files."""

from __future__ import annotations

import copy
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import InputError

# Values of a file, repeats by aliases counted. Aliases of aliases reach it in a few lines.
_MOST_VALUES = 1_000_000


class _OneKeyOnce(yaml.SafeLoader):
    """Refuses mappings with the same key twice, of which PyYAML silently keeps the last."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """The mapping as it is written, before others are merged into it."""
        node = super().compose_mapping_node(anchor)
        first: dict[tuple[str, str], yaml.Mark] = {}
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            known = first.setdefault((key.tag, key.value), key.start_mark)
            if known is not key.start_mark:
                told = f"key {key.value!r} is there twice, first in line {known.line + 1}"
                raise yaml.composer.ComposerError(problem=told, problem_mark=key.start_mark)
        return node


def read_yaml(path: AnyPath) -> Any:
    """Content of a YAML file.

    Raises
    ------
    InputError : missing, not text, or not YAML (with the line).
    """
    try:
        return copy.deepcopy(_parsed(Path(path).read_text(encoding="utf-8")))
    except OSError as error:
        raise InputError("cannot be read", where=str(path), found=error.strerror) from error
    except UnicodeDecodeError as error:
        raise InputError("is not UTF-8 text", where=str(path)) from error
    except (RecursionError, OverflowError) as error:
        raise InputError(
            "is nested too deeply, or repeats itself by aliases without end", where=str(path)
        ) from error
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2024-13-45
        mark = getattr(error, "problem_mark", None)
        line = f"{path}, line {mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or getattr(error, "reason", error)
        raise InputError("is not valid YAML", where=line, found=problem) from error


@lru_cache(maxsize=64)
def _parsed(text: str) -> Any:
    """Content of a text that every site names anew, such as the plans; callers get copies."""
    content = yaml.load(text, _OneKeyOnce)
    _check_size(content, {})
    return content


def _check_size(content: Any, known: dict[int, int]) -> int:
    """Number of values with those that aliases repeat; refuses what grows without end."""
    if not isinstance(content, dict | list):
        return 1
    if id(content) not in known:
        known[id(content)] = _MOST_VALUES  # until it is known: a list within itself has no end
        parts = content.values() if isinstance(content, dict) else content
        known[id(content)] = 1 + sum(_check_size(part, known) for part in parts)
    if known[id(content)] >= _MOST_VALUES:
        raise OverflowError
    return known[id(content)]
