"""Results of the two jobs: plans with what-if, and poles with decisions."""

from __future__ import annotations

from typing import Any

from flask import Blueprint

from roadsight.studio.layout import Layouts, WhatIf
from roadsight.studio.project import Project
from roadsight.studio.requests import body


def create(project: Project) -> Blueprint:
    """Routes on results."""
    routes = Blueprint("results", __name__)
    layouts = Layouts(project)

    @routes.get("/sites/<stem>/plans/<plan>")
    def plan_of(stem: str, plan: str) -> dict[str, Any]:
        return layouts.of(stem, plan).about()

    @routes.post("/sites/<stem>/plans/<plan>/coverage")
    def coverage(stem: str, plan: str) -> dict[str, Any]:
        return layouts.coverage(stem, plan, body(WhatIf))

    return routes
