"""YAML files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import yaml

from roadsight.errors import InputError


def read_yaml(path: str | os.PathLike[str]) -> Any:
    """Content of a YAML file.

    Raises
    ------
    InputError : missing, not text, or not YAML (with the line).
    """
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError("cannot be read", where=str(path), found=error.strerror) from error
    except UnicodeDecodeError as error:
        raise InputError("is not UTF-8 text", where=str(path)) from error
    except RecursionError as error:
        raise InputError("is nested too deeply", where=str(path)) from error
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2024-13-45
        mark = getattr(error, "problem_mark", None)
        line = f"{path}, line {mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or getattr(error, "reason", error)
        raise InputError("is not valid YAML", where=line, found=problem) from error
