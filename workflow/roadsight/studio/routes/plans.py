"""Plans of a site: written and taken away."""

from __future__ import annotations

from typing import Any

from flask import Blueprint

from roadsight.studio.plans.plan_bodies import PlanBody
from roadsight.studio.plans.plan_files import about_plans, remove_plan, save_plan
from roadsight.studio.project import Project
from roadsight.studio.requests import body, version


def create(project: Project) -> Blueprint:
    """Routes on plans."""
    routes = Blueprint("plans", __name__)

    @routes.get("/sites/<stem>/plans")
    def about(stem: str) -> dict[str, Any]:
        return about_plans(project, project.site(stem))

    @routes.put("/sites/<stem>/plans/<plan>")
    def save(stem: str, plan: str) -> dict[str, Any]:
        changed, dropped = save_plan(project, stem, plan, body(PlanBody), version())
        return {"changed": changed, "dropped": dropped}

    @routes.delete("/sites/<stem>/plans/<plan>")
    def remove(stem: str, plan: str) -> dict[str, Any]:
        return {"changed": remove_plan(project, stem, plan, version())}

    return routes
