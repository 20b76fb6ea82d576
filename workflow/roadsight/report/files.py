"""Files of which the report is made, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import resources
from typing import Any

import jinja2

_FOLDERS = {".j2": "templates", ".css": "styles", ".js": "scripts"}


def read_assets(names: Iterable[str]) -> dict[str, str]:
    """Text of templates, styles and scripts of the pages, by file name."""
    assets = resources.files("roadsight.report") / "assets"
    return {
        name: (assets / _FOLDERS[f".{name.rpartition('.')[2]}"] / name).read_text(encoding="utf-8")
        for name in names
    }


STYLES = ("base.css", "parts.css", "views.css", "poles.css")

SCRIPTS = (
    "data.js", "map_tools.js", "plan_canvas.js", "map_view.js", "map_layers.js", "scene_view.js",
    "site.js", "poles_data.js", "poles_map.js", "poles_layers.js", "poles_images.js", "poles.js",
    "main.js",
)  # fmt: skip

TEMPLATES = (
    "report.html.j2", "site.html.j2", "parts.html.j2", "plans.html.j2", "views.html.j2",
    "sensors.html.j2", "options.html.j2", "sight.html.j2", "data.html.j2", "tolerance.html.j2",
    "gaps.html.j2", "evidence.html.j2", "effects.html.j2", "poles.html.j2", "poles_results.html.j2",
    "common.html.j2",
)  # fmt: skip

ASSETS = (*TEMPLATES, *STYLES, *SCRIPTS)  # Names of the files that `render_report` needs


def template_environment(templates: Mapping[str, str]) -> jinja2.Environment:
    """Environment of templates by name, which escapes what it is given and misses nothing."""
    return jinja2.Environment(
        loader=jinja2.DictLoader(dict(templates)),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )


def filled_page(
    template: str, styles: Iterable[str], assets: Mapping[str, str], **content: Any
) -> str:
    """Page of one template and some styles, all by their names in the assets."""
    environment = template_environment({template: assets[template]})
    css = "\n".join(assets[name] for name in styles)
    return environment.get_template(template).render(css=css, **content)
