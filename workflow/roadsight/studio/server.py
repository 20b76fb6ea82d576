"""The studio's server: pages, and one interface under /api/ that they call."""

from __future__ import annotations

import logging
import secrets
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from flask import (
    Blueprint,
    Flask,
    Response,
    abort,
    jsonify,
    redirect,
    request,
    send_file,
    send_from_directory,
)
from werkzeug.exceptions import HTTPException
from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server
from werkzeug.wrappers import Response as AnyResponse

from roadsight.base.errors import InputError
from roadsight.studio.api_routes import (
    PAGES,
    cloud_routes,
    drawing_routes,
    pages,
    plans_routes,
    registration_routes,
    results_routes,
    run_routes,
    site_routes,
)
from roadsight.studio.project import Project
from roadsight.studio.site_files import OutdatedError

log = logging.getLogger("studio")
ASSETS = Path(__file__).with_name("assets")

ROUTES = {
    "site": site_routes,
    "cloud": cloud_routes,
    "drawing": drawing_routes,
    "registration": registration_routes,
    "run": run_routes,
    "results": results_routes,
    "plans": plans_routes,
}

_DEFAULT_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}


def create_app(project: Project, token: str) -> Flask:
    """The application on a project.

    Parameters
    ----------
    token : what every call of the interface must bring.
    """
    app = Flask("roadsight.studio", static_folder=None)
    app.json.sort_keys = False  # type: ignore[attr-defined]
    protect(app, token)
    for name, routes in ROUTES.items():
        app.register_blueprint(routes(project), url_prefix="/api", name=name)
    serve_pages(app, project)
    app.register_error_handler(InputError, _told)
    app.register_error_handler(HTTPException, _refused)
    app.register_error_handler(Exception, _failed)

    @app.get("/")
    def index() -> Response:
        return _asset("index.html")

    @app.get("/assets/<path:name>")
    def asset(name: str) -> Response:
        return _asset(name)

    @app.get("/favicon.ico")
    def icon() -> AnyResponse:
        return redirect("/assets/icon.svg")

    return app


def _asset(name: str) -> Response:
    kind = _DEFAULT_TYPES.get(Path(name).suffix)
    return send_from_directory(ASSETS, name, mimetype=kind)


def _told(error: InputError) -> tuple[Response, int]:
    return jsonify(error=str(error)), 409 if isinstance(error, OutdatedError) else 422


def _refused(error: HTTPException) -> tuple[Response, int]:
    return jsonify(error=error.description), error.code or 500


def _failed(error: Exception) -> tuple[Response, int]:
    """A broken file of the workflow, or a mistake of ours: told to the page, kept in the log."""
    log.exception("a request failed")
    problem = str(error) or "no message"
    return jsonify(error=f"{type(error).__name__}: {problem[:500]}; the terminal shows more"), 500


class _Quiet(WSGIRequestHandler):
    """Requests are not listed; errors are."""

    def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
        """Say nothing."""


def listen(app: Flask, port: int) -> BaseWSGIServer:
    """A server on loopback that answers requests side by side.

    Parameters
    ----------
    port : 0 for any free one.

    Raises
    ------
    InputError : the port is taken.
    """
    try:
        return make_server(LOOPBACK, port, app, threaded=True, request_handler=_Quiet)
    except (OSError, SystemExit) as error:
        raise InputError(
            f"port {port} is taken", where="studio", hint="choose another one with --port"
        ) from error


# Who may talk to the studio: pages that it served itself, with the token of this run.
#
# A page of another site in the same browser can send requests to loopback, directly or under a
# name that it lets point there (DNS rebinding). So the host and origin that a request names are
# compared with the studio's own, and every call of the interface needs a token that only its
# pages know.

LOOPBACK = "127.0.0.1"
TOKEN_HEADER = "X-Roadsight-Token"  # its name, not a secret
API = "/api/"  # Begins the paths that need a token
_NAMES = (LOOPBACK, "localhost")  # Hosts by which a browser on this machine may call the studio
_LARGEST_BYTES = 16 << 20  # Largest request that is read
_SAME = ("same-origin", "none")  # What a browser says of the site of a request that is not foreign

# Pages load nothing from elsewhere and stand in no other page's frame
_POLICY = (
    "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' blob: data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)


def protect(app: Flask, token: str) -> None:
    """Refuse foreign hosts and origins, and calls of the interface without the token."""
    app.config["MAX_CONTENT_LENGTH"] = _LARGEST_BYTES

    @app.before_request
    def check() -> None:
        if not is_own_host(request.headers.get("Host", "")):
            abort(403, "this address is not the studio's: use the one that the terminal shows")
        origin = request.headers.get("Origin")
        if origin is not None and not is_own_origin(origin, request.headers["Host"]):
            abort(403, "requests of other sites are refused")
        if request.headers.get("Sec-Fetch-Site", "none") not in _SAME and _is_call():
            abort(403, "requests of other sites are refused")
        given = request.headers.get(TOKEN_HEADER, "")
        if _is_call() and not secrets.compare_digest(given.encode(), token.encode()):
            abort(401, "open the studio by the address that the terminal shows")

    @app.after_request
    def harden(response: Response) -> Response:
        headers = response.headers
        headers.setdefault("Content-Security-Policy", _POLICY)
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers.setdefault("Cache-Control", "no-store" if _is_call() else "no-cache")
        return response


def is_own_host(host: str) -> bool:
    """Whether a ``Host`` header names loopback, with any port or none."""
    try:
        parts = urlsplit(f"//{host}")
        port = parts.port  # raises where it is no number
        whole = parts.hostname if port is None else f"{parts.hostname}:{port}"
        return parts.hostname in _NAMES and whole == host
    except ValueError:
        return False


def is_own_origin(origin: str, host: str) -> bool:
    """Whether an ``Origin`` header is that of the pages served under ``host``."""
    return origin == f"http://{host}"


def _is_call() -> bool:
    return request.path.startswith(API)


# The workflow's own pages, opened from the studio in tabs of their own.
#
# A link cannot carry the token, so the pages have an address that only the studio's pages know.
# They are not the studio's code: the browser treats them as of another origin, so that nothing in
# them can read the token or call the interface.

_POLICY_PAGES = (
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
        response.headers["Content-Security-Policy"] = _POLICY_PAGES
        return response

    app.register_blueprint(routes)
