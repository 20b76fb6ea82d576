"""What all schemas of settings are made of."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, RootModel, ValidationError

from roadsight.base.errors import InputError, nearest

Positive = Annotated[float, Field(gt=0, le=1e6)]
Metres = Annotated[float, Field(gt=0, le=1000)]
Degrees = Annotated[float, Field(ge=-180, le=180)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
LasClass = Annotated[int, Field(ge=0, le=255)]
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$")]  # safe as a folder and as a wildcard


class Section(BaseModel):
    """A group of settings; unknown keys, infinities and NaN are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_LONGEST_NAME = 255  # bytes of one part of a path (NAME_MAX of Linux)
_LONGEST_PATH = 4095  # bytes of a whole path (PATH_MAX of Linux, less the null that ends it)
# What YAML makes of names such as 171500, 0123, 2024-05-01, no and null without quotes.
_MISREAD = int | float | date
Model = TypeVar("Model", bound=BaseModel)
Given = TypeVar("Given")


def needed(value: Given | None, where: str) -> Given:
    """A value that is not always asked for, and is now.

    Raises
    ------
    InputError : it is absent.
    """
    if value is None:
        raise InputError("is needed here", where=where)
    return value


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
        raise _message(model, error, content, where) from error


def check_path(path: Path, where: str) -> None:
    """Refuse what no file can be called, and braces, which Snakemake takes for wildcards.

    Raises
    ------
    InputError : the path cannot be used.
    """
    text = str(path)
    if set("{}\0") & set(text):
        raise InputError("a path with braces or null characters", where=where, found=repr(text))
    if len(text.encode()) > _LONGEST_PATH or any(
        len(part.encode()) > _LONGEST_NAME for part in path.parts
    ):
        raise InputError("a path too long for a file", where=where, found=text)


def _message(
    model: type[BaseModel], error: ValidationError, content: Any, where: str
) -> InputError:
    # A misspelt key is told before the one that is missing for it.
    first = min(error.errors(), key=lambda part: part["type"] != "extra_forbidden")
    keys = []  # those of the file; beyond them, pydantic names alternatives of a value's type
    for part in first["loc"]:
        if isinstance(content, dict):
            content = content.get(part)
        elif isinstance(content, list) and isinstance(part, int) and part < len(content):
            content = content[part]
        else:
            break
        keys.append(str(part))
    field = ".".join(keys)
    if first["type"] == "extra_forbidden":
        hint = nearest(str(first["loc"][-1]), _keys(model, first["loc"][:-1]))
        return InputError(f"unknown key {field!r}", where=where, hint=hint)
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "missing":
        return InputError(f"key {field!r} is missing", where=where)
    shown = None if isinstance(first["input"], dict) else repr(first["input"])
    hint = ""
    if first["type"] == "string_type" and isinstance(first["input"], _MISREAD | None):
        nothing = first["input"] is None or isinstance(first["input"], bool)
        kind = "date" if isinstance(first["input"], date) else "number"
        kind = "yes, no or nothing" if nothing else kind
        hint = f'put it in quotes: "..." (YAML reads it as a {kind})'
    # The field takes a number or a word: the words are listed too.
    words = [
        part["ctx"]["expected"]
        for part in error.errors()
        if part["type"] == "literal_error" and part["loc"][:-1] == first["loc"][:-1]
    ]
    allowed = f"or {' or '.join(words)}" if words and first["type"] != "literal_error" else None
    return InputError(
        f"{field or 'file'}: {message}", where=where, found=shown, allowed=allowed, hint=hint
    )


def _keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Valid keys of the section at ``location``."""
    for part in location:
        field = model.model_fields.get("root" if issubclass(model, RootModel) else str(part))
        annotation = field.annotation if field else None
        options = getattr(annotation, "__args__", (annotation,))
        sections = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
        # What is no field is a name within a mapping of sections, such as a plan's.
        model = sections[0] if sections else model
    return list(model.model_fields)
