"""Images over the cloud: solved poses, registration by hand, baselines, corrections."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

from flask import Blueprint, Response

from roadsight.studio.project import Project
from roadsight.studio.registration.drive import Drives, SiteDrive
from roadsight.studio.registration.pictures import lens_for, without_distortion
from roadsight.studio.registration.registering import (
    BaselineBody,
    PairsBody,
    PoseBody,
    alignment_error,
    image_content,
    points_around,
    solve_pairs,
)
from roadsight.studio.registration.registration_files import save_baseline, save_correction
from roadsight.studio.requests import body, version
from roadsight.studio.site_files import saving, site_version

_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp"}


def create(project: Project) -> Blueprint:
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
        suffix = PurePath(str(row["path"])).suffix.lower()
        content, kind = drive.picture(number), _TYPES.get(suffix, "application/octet-stream")
        key = str(row["route"]), int(row["width_px"]), int(row["height_px"])
        lens = lens_for(drive.site, key)
        if lens is not None:
            content, kind = without_distortion(content, lens), _TYPES[".jpg"]
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
