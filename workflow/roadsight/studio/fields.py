"""What forms of the studio ask for, as the schemas that check it have it."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel


def field_of(section: type[BaseModel], name: str) -> dict[str, Any]:
    """Description, type, range, pattern and choices of a field, as JSON schema has them."""
    told: dict[str, Any] = section.model_json_schema()["properties"][name]
    kinds = [kind for kind in told.pop("anyOf", ()) if kind["type"] != "null"]
    return told | (kinds[0] if kinds else {})
