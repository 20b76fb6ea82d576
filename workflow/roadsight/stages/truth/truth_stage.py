"""What the stages that measure on real data share."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from roadsight.evidence.truth_catalogue import Figure
from roadsight.io.records.atomic import write_json
from roadsight.stages.command import Command

log = logging.getLogger("truth")

Measure = Callable[[str, Sequence[Path]], list[Figure]]
"""Figures of a data set from its name and its files."""


def measuring(measure: Measure, about: str | None) -> Command:
    """Command line of a stage that measures one data set."""

    def stage(
        dataset: str,
        files: Sequence[Path] = (),
        missing: Annotated[Sequence[str], "patterns that match no file"] = (),
        *,
        out: Annotated[Path, "JSON file to write"],
    ) -> None:
        if missing:
            log.warning("%s: no such file: %s", dataset, ", ".join(missing))
            write_json(out, {"missing": missing, "figures": []})
            return
        figures = measure(dataset, files)
        for figure in figures:
            beside = "" if figure.peer is None else f", peer {figure.peer:.4g}"
            log.info("%s: %s %.4g%s", dataset, figure.metric, figure.ours, beside)
        write_json(out, {"missing": [], "figures": [asdict(f) for f in figures]})

    return Command(stage, about)
