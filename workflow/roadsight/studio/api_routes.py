"""What the pages call under /api/: routes on the project, its sites and its workflow."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pandas as pd
from flask import Blueprint, Response, request

from roadsight import __version__
from roadsight.base.errors import InputError
from roadsight.io.cloud.tiles import stack_xyz
from roadsight.io.records.atomic import read_json
from roadsight.report.tradeoffs_page import measure_views
from roadsight.studio.cloud_tiles import REACH_M, Clouds, snap_to_cloud
from roadsight.studio.drawing import (
    Drawing,
    Metre,
    current_area,
    load_drawing,
    preview,
    save_drawing,
    terrain_of,
)
from roadsight.studio.drive_views import (
    Drives,
    SiteDrive,
    lens_for,
    picture_type,
    without_distortion,
)
from roadsight.studio.layout import Layouts, WhatIf
from roadsight.studio.plan_files import (
    TYPES,
    Export,
    PlanBody,
    about_plans,
    exported,
    remove_plan,
    save_plan,
)
from roadsight.studio.pole_review import Decisions, Pictures, review, save_decisions
from roadsight.studio.project import Project, SiteFolder
from roadsight.studio.registering import (
    BaselineBody,
    PairsBody,
    PoseBody,
    alignment_error,
    image_content,
    points_around,
    save_baseline,
    save_correction,
    solve_pairs,
)
from roadsight.studio.requests import Body, body, version
from roadsight.studio.run_progress import Order
from roadsight.studio.runs import Runs
from roadsight.studio.site_files import CloudBody, new_site, saving, site_version

# Pages of the workflow by their path under results
PAGES = {
    "report.html": "Report",
    "tradeoffs/index.html": "Accuracy and time",
    "hardcases/index.html": "Hard cases",
    "audit/index.html": "Effects audited",
    "bench/index.html": "Benchmarks",
}

_EFFECT_FIELDS = {"effect", "job", "decision", "quantity", "value", "unit", "threshold", "reason"}


def effects_of(site: SiteFolder) -> dict[str, Any]:
    """Decisions on effects; none before they were made.

    Raises
    ------
    InputError : the file is damaged.
    """
    path = site.results / "effects.json"
    if not path.exists():
        return {"effects": []}
    content = read_json(path)
    if not isinstance(content, list) or not all(
        isinstance(row, dict) and row.keys() >= _EFFECT_FIELDS for row in content
    ):
        raise InputError("is damaged", where=str(path), hint="delete it and run the workflow")
    return {"effects": content}


def frontiers(results: Path) -> dict[str, Any]:
    """Chart (SVG), verdict and rows of each measure of each knob that was swept.

    Raises
    ------
    InputError : the table is damaged.
    """
    path = results / "tradeoffs/tradeoffs.csv"
    if not path.exists():
        return {"studies": []}
    try:
        table = pd.read_csv(path)
        groups = table.groupby(["job", "knob"], sort=False)
        studies = [
            {"job": job, "knob": knob, "views": measure_views(cast(Any, part.to_dict("records")))}
            for (job, knob), part in groups
        ]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "is damaged", where=str(path), hint="delete it and run: snakemake tradeoffs"
        ) from error
    return {"studies": studies}


def pages(results: Path, address: str) -> list[dict[str, str]]:
    """Pages that are there, with the addresses under which the studio shows them."""
    return [
        {"title": title, "url": f"{address}/{path}"}
        for path, title in PAGES.items()
        if (results / path).is_file()
    ]


def site_routes(project: Project) -> Blueprint:
    """Routes on the project, and on clouds of this machine that are no site yet."""
    routes = Blueprint("site", __name__)

    @routes.get("/project")
    def overview() -> dict[str, Any]:
        return project.overview() | {"version": __version__}

    @routes.post("/clouds")
    def look() -> dict[str, Any]:
        return new_site(project, body(CloudBody))

    return routes


class Place(Body):
    """A place in plan, local metres."""

    x: Metre
    y: Metre


def cloud_routes(project: Project) -> Blueprint:
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


def drawing_routes(project: Project) -> Blueprint:
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


def plans_routes(project: Project) -> Blueprint:
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


def registration_routes(project: Project) -> Blueprint:
    """Routes on the images of a site."""
    routes = Blueprint("registration", __name__)
    drives = Drives()

    def drive_of(stem: str) -> SiteDrive:
        return drives.of(project.site(stem))

    def now(stem: str) -> dict[str, str]:
        return {"version": site_version(project.site(stem), "registration")}

    @routes.get("/sites/<stem>/images")
    def images(stem: str) -> dict[str, Any]:
        state = now(stem)
        drive = drive_of(stem)
        road = drive.scene.edges.xyz_m[::4, :2].round(2).ravel().tolist()
        return {"images": drive.about(), "road": road} | state

    @routes.get("/sites/<stem>/images/<int:number>")
    def image(stem: str, number: int) -> dict[str, Any]:
        return image_content(drive_of(stem), number)

    @routes.get("/sites/<stem>/images/<int:number>/picture")
    def picture(stem: str, number: int) -> Response:
        drive = drive_of(stem)
        row = drive.row(number)
        content, kind = drive.picture(number), picture_type(str(row["path"]))
        key = str(row["route"]), int(row["width_px"]), int(row["height_px"])
        lens = lens_for(drive.site, key)
        if lens is not None:
            content, kind = without_distortion(content, lens), "image/jpeg"
        return Response(content, mimetype=kind)

    @routes.get("/sites/<stem>/images/<int:number>/points")
    def points(stem: str, number: int) -> Response:
        content = points_around(project.site(stem), drive_of(stem), number)
        return Response(content, mimetype="application/octet-stream")

    @routes.post("/sites/<stem>/images/<int:number>/error")
    def error(stem: str, number: int) -> dict[str, Any]:
        drive = drive_of(stem)
        return alignment_error(drive, drive.place(number), body(PoseBody).row())

    @routes.post("/sites/<stem>/images/<int:number>/solve")
    def solve(stem: str, number: int) -> dict[str, Any]:
        return solve_pairs(drive_of(stem), number, body(PairsBody).pairs)

    @routes.put("/sites/<stem>/images/<int:number>/correction")
    def correct(stem: str, number: int) -> dict[str, Any]:
        pose = body(PoseBody)
        with saving(project, stem, "registration", version()):
            return {"changed": save_correction(project, drive_of(stem), number, pose)} | now(stem)

    @routes.delete("/sites/<stem>/images/<int:number>/correction")
    def forget(stem: str, number: int) -> dict[str, Any]:
        with saving(project, stem, "registration", version()):
            return {"changed": save_correction(project, drive_of(stem), number, None)} | now(stem)

    @routes.put("/sites/<stem>/baseline")
    def keep(stem: str) -> dict[str, Any]:
        images = body(BaselineBody).images
        with saving(project, stem, "registration", version()):
            return save_baseline(project, drive_of(stem), images) | now(stem)

    return routes


def results_routes(project: Project) -> Blueprint:
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


class Stop(Body):
    """How to stop."""

    firmly: bool = False


def run_routes(project: Project) -> Blueprint:
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
