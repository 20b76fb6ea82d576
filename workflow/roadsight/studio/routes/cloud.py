"""The cloud, tile by tile."""

from __future__ import annotations

from typing import Any

from flask import Blueprint, Response

from roadsight.studio.cloud import Clouds
from roadsight.studio.project import Project


def create(project: Project) -> Blueprint:
    """Routes on the cloud of a site."""
    routes = Blueprint("cloud", __name__)
    clouds = Clouds()

    @routes.get("/sites/<stem>/cloud")
    def about(stem: str) -> dict[str, Any]:
        return clouds.of(project.site(stem)).about()

    @routes.get("/sites/<stem>/cloud/<int:tile>/<int:level>")
    def chunk(stem: str, tile: int, level: int) -> Response:
        content = clouds.of(project.site(stem)).chunk(tile, level)
        return Response(content, mimetype="application/octet-stream")

    return routes
