"""The data flow of a job as the workflow has it: its rules by chapter, drawn by graphviz.

``snakemake placement --rulegraph dot | python scripts/flow.py OUT.svg``
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

COLOURS = {
    "scene": ("#15803d", "#f0fdf4"),
    "placement": ("#1d4ed8", "#eff6ff"),
    "poles": ("#b45309", "#fffbeb"),
    "evidence": ("#6b21a8", "#faf5ff"),
}
"""Outline and filling of each chapter's rules."""

STAGES = Path(__file__).resolve().parents[1] / "workflow" / "roadsight" / "stages"


def chapter_of(rule: str) -> str | None:
    """Chapter of a rule's stage; None for rules that only gather targets."""
    return next((c for c in COLOURS if (STAGES / c / f"{rule}.py").is_file()), None)


def coloured(graph: str) -> str:
    """A rule graph with each rule in the colours of its chapter."""

    def style(match: re.Match[str]) -> str:
        line, fill = COLOURS.get(chapter_of(match[1]) or "", ("#475569", "#f8fafc"))
        return f'[label = "{match[1]}", color="{line}", style="rounded,filled", fillcolor="{fill}"]'

    return re.sub(r'\[label = "(\w+)", color = [^\]]*\]', style, graph)


if __name__ == "__main__":
    # `tred` leaves out what longer ways imply; of the rounds' cycle it warns, and keeps it.
    straight = subprocess.run(
        ["tred"], input=coloured(sys.stdin.read()), stdout=subprocess.PIPE, check=True, text=True
    ).stdout
    subprocess.run(["dot", "-Tsvg", "-o", sys.argv[1]], input=straight, check=True, text=True)
