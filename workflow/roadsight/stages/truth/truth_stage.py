"""What the stages that measure on real data share."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from roadsight.evidence.truth.table import Figure
from roadsight.io.records.atomic import write_json
from roadsight.stages.command import run_stage

log = logging.getLogger("truth")

Measure = Callable[[str, Sequence[Path]], list[Figure]]
"""Figures of a data set from its name and its files."""


def truth_main(about: str | None, measure: Measure, argv: Sequence[str] | None) -> int:
    """Command line of a stage that measures one data set."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--dataset", required=True)
    parser.add_argument("--files", nargs="*", type=Path, default=[])
    parser.add_argument("--missing", nargs="*", default=[], help="patterns that match no file")
    parser.add_argument("--out", required=True, help="JSON file to write")

    def stage(arguments: argparse.Namespace) -> None:
        if arguments.missing:
            log.warning("%s: no such file: %s", arguments.dataset, ", ".join(arguments.missing))
            write_json(arguments.out, {"missing": arguments.missing, "figures": []})
            return
        figures = measure(arguments.dataset, arguments.files)
        for figure in figures:
            beside = "" if figure.peer is None else f", peer {figure.peer:.4g}"
            log.info("%s: %s %.4g%s", arguments.dataset, figure.metric, figure.ours, beside)
        write_json(arguments.out, {"missing": [], "figures": [asdict(f) for f in figures]})

    return run_stage(parser, stage, argv)
