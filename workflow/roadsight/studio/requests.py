"""What a request brings, checked."""

from __future__ import annotations

from typing import Any, TypeVar

from flask import request
from pydantic import BaseModel, ConfigDict, ValidationError

from roadsight.base.errors import InputError


class Body(BaseModel):
    """Content that a page sends; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid")


Model = TypeVar("Model", bound=Body)


def version() -> str:
    """What the page says that its content rests on (``If-Match``); empty if it says nothing."""
    return request.headers.get("If-Match", "")


def body(model: type[Model]) -> Model:
    """Content of the request as a model.

    Raises
    ------
    InputError : it is no JSON, or not as the model says.
    """
    kind, given = "application/json", request.mimetype
    if given != kind:
        raise InputError("is of another kind", where="request", found=given, allowed=kind)
    try:
        return model.model_validate_json(request.get_data())
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "request"
        raise InputError(first["msg"], where=place, found=first.get("input")) from error


def field_of(section: type[BaseModel], name: str) -> dict[str, Any]:
    """Description, type, range, pattern and choices of a field, as JSON schema has them."""
    told: dict[str, Any] = section.model_json_schema()["properties"][name]
    kinds = [kind for kind in told.pop("anyOf", ()) if kind["type"] != "null"]
    return told | (kinds[0] if kinds else {})
