"""Validation that ends in one clear message: file, field, value found, value allowed."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from roadsight.errors import InputError, nearest

Model = TypeVar("Model", bound=BaseModel)


def validated(model: type[Model], content: Any, where: str) -> Model:
    """Check ``content`` against ``model``.

    Raises
    ------
    InputError : for the first thing that is wrong; a misspelt key is told its nearest valid one.
    """
    if not isinstance(content, dict):
        raise InputError("must be a mapping of keys to values", where=where, found=repr(content))
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise _message(model, error, where) from error


def _message(model: type[BaseModel], error: ValidationError, where: str) -> InputError:
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        keys = _keys(model, first["loc"][:-1])
        return InputError(
            f"unknown key {field!r}", where=where, hint=nearest(str(first["loc"][-1]), keys)
        )
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "missing":
        return InputError(f"key {field!r} is missing", where=where)
    shown = None if isinstance(first["input"], dict) else repr(first["input"])
    return InputError(f"{field or 'file'}: {message}", where=where, found=shown)


def _keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Valid keys of the section at ``location``."""
    for part in location:
        annotation = model.model_fields[str(part)].annotation if isinstance(part, str) else None
        options = getattr(annotation, "__args__", (annotation,))
        sections = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
        if not sections:
            return []
        model = sections[0]
    return list(model.model_fields)
