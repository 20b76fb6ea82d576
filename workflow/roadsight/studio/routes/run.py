"""The workflow: what is stale, a run, and what it has told."""

from __future__ import annotations

from typing import Any

from flask import Blueprint
from pydantic import BaseModel, ConfigDict

from roadsight.studio.project import Project
from roadsight.studio.requests import body
from roadsight.studio.results.evidence_pages import effects_of, frontiers
from roadsight.studio.run.runs import Runs
from roadsight.studio.run.snakemake_calls import Order


class Stop(BaseModel):
    """How to stop."""

    model_config = ConfigDict(extra="forbid")
    firmly: bool = False


def create(project: Project) -> Blueprint:
    """Routes on the workflow."""
    routes = Blueprint("run", __name__)
    runs = Runs(project)

    @routes.get("/run")
    def state() -> dict[str, Any]:
        return runs.state()

    @routes.post("/run/plan")
    def plan() -> dict[str, Any]:
        return runs.plan(body(Order))

    @routes.post("/run/start")
    def start() -> dict[str, Any]:
        runs.start(body(Order))
        return runs.state()

    @routes.post("/run/stop")
    def stop() -> dict[str, Any]:
        runs.stop(body(Stop).firmly)
        return runs.state()

    @routes.post("/run/unlock")
    def unlock() -> dict[str, Any]:
        runs.unlock()
        return runs.state()

    @routes.get("/run/log/<int:number>")
    def log(number: int) -> dict[str, Any]:
        return runs.log(number)

    @routes.get("/sites/<stem>/effects")
    def effects(stem: str) -> dict[str, Any]:
        return effects_of(project.site(stem))

    @routes.get("/frontiers")
    def frontier() -> dict[str, Any]:
        return frontiers(project.root / "results")

    return routes
