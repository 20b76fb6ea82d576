"""Results of the two jobs: plans with what-if, and poles with decisions."""

from __future__ import annotations

from typing import Any

from flask import Blueprint, Response, request

from roadsight.studio.plans.exports import TYPES, Export, exported
from roadsight.studio.project import Project
from roadsight.studio.requests import body, version
from roadsight.studio.results.layout import Layouts, WhatIf
from roadsight.studio.results.pole_review import Decisions, Pictures, review, save_decisions
from roadsight.studio.site_files import saving, site_version


def create(project: Project) -> Blueprint:
    """Routes on results."""
    routes = Blueprint("results", __name__)
    layouts, pictures = Layouts(project), Pictures()

    @routes.get("/sites/<stem>/plans/<plan>")
    def plan_of(stem: str, plan: str) -> dict[str, Any]:
        return layouts.of(stem, plan).about()

    @routes.post("/sites/<stem>/plans/<plan>/coverage")
    def coverage(stem: str, plan: str) -> dict[str, Any]:
        return layouts.coverage(stem, plan, body(WhatIf))

    @routes.post("/sites/<stem>/plans/<plan>/export")
    def export(stem: str, plan: str) -> Response:
        asked = body(Export)
        layout = layouts.asked(stem, plan, asked)
        name, content = exported(project.site(stem), plan, layout, asked)
        response = Response(content, mimetype=TYPES[asked.format])
        response.headers.set("Content-Disposition", "attachment", filename=name)
        return response

    @routes.get("/sites/<stem>/poles")
    def poles(stem: str) -> dict[str, Any]:
        return review(project.site(stem))

    @routes.put("/sites/<stem>/poles")
    def decide(stem: str) -> dict[str, Any]:
        asked = body(Decisions).decisions
        with saving(project, stem, "decisions", version()):
            changed = save_decisions(project, stem, asked)
            return {"changed": changed, "version": site_version(project.site(stem), "decisions")}

    @routes.get("/sites/<stem>/poles/picture")
    def image(stem: str) -> Response:
        name, view = request.args.get("image", ""), request.args.get("view", "")
        content, kind = pictures.of(project.site(stem), name, view)
        return Response(content, mimetype=kind)

    return routes
