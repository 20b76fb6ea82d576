"""The project and its sites."""

from __future__ import annotations

from typing import Any

from flask import Blueprint

from roadsight import __version__
from roadsight.studio.project import Project


def create(project: Project) -> Blueprint:
    """Routes on the project."""
    routes = Blueprint("site", __name__)

    @routes.get("/project")
    def overview() -> dict[str, Any]:
        return project.overview() | {"version": __version__}

    return routes
