"""The cloud, tile by tile."""

from __future__ import annotations

from typing import Any

from flask import Blueprint, Response, request

from roadsight.io.cloud.tiles import stack_xyz
from roadsight.studio.cloud.cloud import Clouds
from roadsight.studio.cloud.snapping import REACH_M, snap_to_cloud
from roadsight.studio.edges.shapes import Metre, Shape
from roadsight.studio.project import Project
from roadsight.studio.requests import body


class Place(Shape):
    """A place in plan, local metres."""

    x: Metre
    y: Metre


def create(project: Project) -> Blueprint:
    """Routes on the cloud of a site."""
    routes = Blueprint("cloud", __name__)
    clouds = Clouds()

    @routes.get("/sites/<stem>/cloud")
    def about(stem: str) -> dict[str, Any]:
        return clouds.of(project.site(stem)).about()

    @routes.get("/sites/<stem>/cloud/<int:tile>/<int:level>")
    def chunk(stem: str, tile: int, level: int) -> Response:
        content = clouds.of(project.site(stem)).chunk(tile, level, request.args.get("version", ""))
        return Response(content, mimetype="application/octet-stream")

    @routes.post("/sites/<stem>/snap")
    def snap(stem: str) -> dict[str, Any]:
        place = body(Place)
        points = clouds.of(project.site(stem)).around(place.x, place.y, 2 * REACH_M)
        found = snap_to_cloud(stack_xyz(points), points["intensity"], (place.x, place.y))
        return {"place": found}

    return routes
