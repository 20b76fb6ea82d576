"""``roadsight studio``: the local web application on a project."""

from __future__ import annotations

import os
import secrets
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

from roadsight.commands.verb import Verb

PORT = 8711  # of the studio, unless the user names another
_FOLDER = ".snakemake/roadsight"  # the studio's own files, beside Snakemake's, below the project


def run(
    folder: Annotated[Path, "the project; default: here"] = Path(),
    port: Annotated[int, "0: any free one"] = PORT,
    no_browser: Annotated[bool, "only show the address"] = False,
) -> None:
    """Serve on loopback until interrupted.

    Raises
    ------
    InputError : no project there, or the port is taken.
    """
    from roadsight.studio.project import Project, find_project  # noqa: PLC0415  # of this verb only
    from roadsight.studio.server import LOOPBACK, create_app, listen  # noqa: PLC0415

    root = find_project(folder)
    os.chdir(root)
    token = secrets.token_urlsafe(24)
    server = listen(create_app(Project(root), token), port)
    address = f"http://{LOOPBACK}:{server.server_port}/#token={token}"
    print(f"Studio of {root}: {address}\nEnd it with Ctrl+C.", flush=True)
    try:
        with ExitStack() as opened:
            if not no_browser:
                page = opened.enter_context(_way_in(root / _FOLDER, address))
                webbrowser.open(page.as_uri())
            server.serve_forever()
    except KeyboardInterrupt:
        print("Studio ended.")
    finally:
        server.server_close()


@contextmanager
def _way_in(folder: Path, address: str) -> Iterator[Path]:
    """A page that leads to an address, which only this user can read.

    The browser is told this page, not the address: everybody on the machine can read the arguments
    of a process, and the address holds the token.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # In the project, since browsers in a sandbox may not see the folder for temporary files.
    handle, name = tempfile.mkstemp(prefix="open-", suffix=".html", dir=folder)
    path = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as page:
            page.write(
                '<!doctype html><meta charset="utf-8"><title>roadsight studio</title>'
                f'<meta http-equiv="refresh" content="0; url={address}">'
            )
        yield path
    finally:
        path.unlink(missing_ok=True)


VERB = Verb("studio", "see, draw, register and run in the browser", run)
