"""What people draw: edges, zones, mounts, monitored area."""

from __future__ import annotations

from typing import Any

from flask import Blueprint

from roadsight.studio.edges.drawing import current_area, load_drawing, save_drawing, terrain_of
from roadsight.studio.edges.preview import preview
from roadsight.studio.edges.shapes import Drawing
from roadsight.studio.project import Project
from roadsight.studio.requests import body, version
from roadsight.studio.site_files import saving, site_version


def create(project: Project) -> Blueprint:
    """Routes on the drawing of a site."""
    routes = Blueprint("drawing", __name__)

    @routes.get("/sites/<stem>/drawing")
    def load(stem: str) -> dict[str, Any]:
        return load_drawing(project.site(stem))

    @routes.put("/sites/<stem>/drawing")
    def save(stem: str) -> dict[str, Any]:
        drawing = body(Drawing)
        with saving(project, stem, "drawing", version()):
            changed = save_drawing(project, stem, drawing)
            return {"changed": changed, "version": site_version(project.site(stem), "drawing")}

    @routes.post("/sites/<stem>/preview")
    def look(stem: str) -> dict[str, Any]:
        site = project.site(stem)
        frame = site.frame()
        settings = site.resolved.settings.candidates
        return preview(
            body(Drawing),
            current_area(site, frame),
            terrain_of(site, frame),
            settings.spacing_m,
            settings.arm_m,
        )

    return routes
