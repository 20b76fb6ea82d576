"""New sites from clouds on this machine."""

from __future__ import annotations

from typing import Any

from flask import Blueprint

from roadsight.studio.new_site import CloudBody, new_site
from roadsight.studio.project import Project
from roadsight.studio.requests import body


def create(project: Project) -> Blueprint:
    """Routes on clouds that are no site yet."""
    routes = Blueprint("clouds", __name__)

    @routes.post("/clouds")
    def look() -> dict[str, Any]:
        return new_site(project, body(CloudBody))

    return routes
