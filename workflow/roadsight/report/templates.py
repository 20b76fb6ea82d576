"""How all pages fill their templates."""

from __future__ import annotations

from collections.abc import Mapping

import jinja2


def template_environment(templates: Mapping[str, str]) -> jinja2.Environment:
    """Environment of templates by name, which escapes what it is given and misses nothing."""
    return jinja2.Environment(
        loader=jinja2.DictLoader(dict(templates)),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
