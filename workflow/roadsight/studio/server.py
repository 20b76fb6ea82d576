"""The studio's server: pages, and one interface under /api/ that they call."""

from __future__ import annotations

import logging
from importlib import import_module
from pathlib import Path

from flask import Flask, Response, jsonify, redirect, send_from_directory
from werkzeug.exceptions import HTTPException
from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server
from werkzeug.wrappers import Response as AnyResponse

from roadsight.base.errors import InputError
from roadsight.studio.guard import LOOPBACK, protect
from roadsight.studio.pages import serve_pages
from roadsight.studio.project import Project
from roadsight.studio.site_files import OutdatedError

log = logging.getLogger("studio")
ASSETS = Path(__file__).with_name("assets")
ROUTES = ("site", "cloud", "drawing", "registration", "run", "results", "plans", "clouds")
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
    for name in ROUTES:
        routes = import_module(f"roadsight.studio.routes.{name}")
        app.register_blueprint(routes.create(project), url_prefix="/api", name=name)
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
