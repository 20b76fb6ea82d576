"""Formulas as MathML, which browsers draw without a script."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    """Let Sphinx draw formulas this way; see ``html_math_renderer`` in ``docs/conf.py``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(convert(node.astext().strip(), display="inline"))
    raise nodes.SkipNode


def _display(translator: Any, node: nodes.math_block) -> None:
    """A formula in a line of its own, its number (its label) at the right."""
    translator.body.append(
        f'<div class="formula">{convert(node.astext().strip(), display="block")}'
    )
    if node.get("number"):
        translator.body.append(f'<span class="number">({node["number"]})</span>')
    translator.body.append("</div>")
    raise nodes.SkipNode
