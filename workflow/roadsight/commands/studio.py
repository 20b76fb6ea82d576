"""``roadsight studio``: the local web application on a project."""

from __future__ import annotations

import argparse
import os
import webbrowser
from pathlib import Path

PORT = 8711


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("studio", help="see, draw, register and run in the browser")
    parser.add_argument("--folder", type=Path, default=Path(), help="the project; default: here")
    parser.add_argument("--port", type=int, default=PORT, help="0: any free one")
    parser.add_argument("--no-browser", action="store_true", help="only show the address")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Serve on loopback until interrupted.

    Raises
    ------
    InputError : no project there, or the port is taken.
    """
    from roadsight.studio.guard import LOOPBACK, new_token  # noqa: PLC0415  # only this verb needs it
    from roadsight.studio.project import Project, find_project  # noqa: PLC0415
    from roadsight.studio.server import create_app, listen  # noqa: PLC0415

    root = find_project(arguments.folder)
    os.chdir(root)
    token = new_token()
    server = listen(create_app(Project(root), token), arguments.port)
    address = f"http://{LOOPBACK}:{server.server_port}/#token={token}"
    print(f"Studio of {root}: {address}\nEnd it with Ctrl+C.", flush=True)
    if not arguments.no_browser:
        webbrowser.open(address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        print("Studio ended.")
    finally:
        server.server_close()
