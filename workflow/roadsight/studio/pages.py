"""The workflow's own pages, opened from the studio in tabs of their own.

A link cannot carry the token, so the pages have an address that only the studio's pages know. They
are not the studio's code: the browser treats them as of another origin, so that nothing in them
can read the token or call the interface.
"""

from __future__ import annotations

import secrets
from typing import Any

from flask import Blueprint, Flask, Response, abort, send_file

from roadsight.studio.project import Project
from roadsight.studio.results.evidence_pages import PAGES, pages

_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; worker-src blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)


def serve_pages(app: Flask, project: Project) -> None:
    """Add the addresses of the pages, and the call that tells them."""
    key = secrets.token_urlsafe(24)
    routes = Blueprint("pages", __name__)

    @routes.get("/api/pages")
    def there() -> dict[str, Any]:
        return {"pages": pages(project.root / "results", f"/pages/{key}")}

    @routes.get("/pages/<given>/<path:name>")
    def page(given: str, name: str) -> Response:
        if not secrets.compare_digest(given.encode(), key.encode()) or name not in PAGES:
            abort(404, "no such page: open it from the studio")
        path = project.named(f"results/{name}")
        if not path.is_file():
            abort(404, "this page is not there: run the workflow")
        response = send_file(path, mimetype="text/html")
        response.headers["Content-Security-Policy"] = _POLICY
        return response

    app.register_blueprint(routes)
