"""Plans of a site: written, taken away, and their sensors as files."""

from __future__ import annotations

from typing import Any

from flask import Blueprint, Response

from roadsight.base.errors import InputError
from roadsight.studio.plans.exports import TYPES, Export, exported
from roadsight.studio.plans.plan_bodies import PlanBody
from roadsight.studio.plans.plan_files import about_plans, remove_plan, save_plan
from roadsight.studio.project import Project
from roadsight.studio.requests import body
from roadsight.studio.results.layout import Layouts


def create(project: Project) -> Blueprint:
    """Routes on plans."""
    routes = Blueprint("plans", __name__)
    layouts = Layouts(project)

    @routes.get("/sites/<stem>/plans")
    def about(stem: str) -> dict[str, Any]:
        return about_plans(project, project.site(stem))

    @routes.put("/sites/<stem>/plans/<plan>")
    def save(stem: str, plan: str) -> dict[str, Any]:
        return {"changed": save_plan(project, stem, plan, body(PlanBody))}

    @routes.delete("/sites/<stem>/plans/<plan>")
    def remove(stem: str, plan: str) -> dict[str, Any]:
        return {"changed": remove_plan(project, stem, plan)}

    @routes.post("/sites/<stem>/plans/<plan>/export")
    def export(stem: str, plan: str) -> Response:
        asked = body(Export)
        layout = layouts.of(stem, plan)
        if layout.version != asked.version:
            raise InputError("was computed anew meanwhile", where=f"plan {plan}", hint="reload")
        name, content = exported(project.site(stem), plan, layout, asked)
        response = Response(content, mimetype=TYPES[asked.format])
        response.headers["Content-Disposition"] = f'attachment; filename="{name}"'
        return response

    return routes
