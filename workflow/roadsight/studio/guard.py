"""Who may talk to the studio: pages that it served itself, with the token of this run.

A page of another site in the same browser can send requests to loopback, directly or under a name
that it lets point there (DNS rebinding). So the host and origin that a request names are compared
with the studio's own, and every call of the interface needs a token that only its pages know.
"""

from __future__ import annotations

import secrets
from urllib.parse import urlsplit

from flask import Flask, Response, abort, request

LOOPBACK = "127.0.0.1"
TOKEN_HEADER = "X-Roadsight-Token"  # its name, not a secret
API = "/api/"
"""Begins the paths that need a token."""
_NAMES = (LOOPBACK, "localhost")
"""Hosts by which a browser on this machine may call the studio."""
_LARGEST_BYTES = 16 << 20
"""Largest request that is read."""
_SAME = ("same-origin", "none")
"""What a browser says of the site of a request that is not foreign."""
_POLICY = (
    "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' blob: data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""Pages load nothing from elsewhere and stand in no other page's frame."""


def new_token() -> str:
    """A token that cannot be guessed."""
    return secrets.token_urlsafe(24)


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
