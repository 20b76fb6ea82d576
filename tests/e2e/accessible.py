"""Rules of accessibility: axe-core, as a package for tests brings it."""

from importlib.resources import files

import pytest

GRAVE = ("serious", "critical")


def axe():
    """Text of axe-core; tests that need it are skipped where the package is not installed."""
    pytest.importorskip("axe_playwright_python")
    return (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")


def findings(page, source):
    """Serious and critical findings on what a page shows: rule, why, and where."""
    page.run("Promise.all(document.getAnimations().map((one) => one.finished.catch(() => null)))")
    page.run(f"{source}; null")
    found = page.run("""axe.run(document, { resultTypes: ['violations'] }).then(({ violations }) =>
        violations.map(({ id, impact, help, nodes }) => [id, impact, help,
            nodes.map(({ target, html }) => `${target.join(' ')}: ${html.slice(0, 120)}`)]))""")
    return [one for one in found if one[1] in GRAVE]
