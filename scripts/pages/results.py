"""Pages of measured and of published results, from the tables that hold them; none is pasted."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.bench_page import BOUND, is_bound
from roadsight.base.texts import read_yaml
from roadsight.evidence.truth_catalogue import AREAS, MEAN, holds
from roadsight.report.tradeoffs_page import plain_table
from roadsight.report.truth_page import words
from scripts.pages.markdown import code, escaped, table

_NONE = "–"  # noqa: RUF001
_ROUNDING = 1e-9
"""What is nearer to zero is rounding of a solver."""


def results_pages(results: Path) -> dict[str, str]:
    """Markdown of the pages by name.

    Parameters
    ----------
    results : folder of results; what is missing there is said on its page.
    """
    pages: dict[str, tuple[str, str, str, Callable[[Path], str]]] = {
        "tradeoffs": (
            "What accuracy costs, measured",
            "tradeoffs/tradeoffs.csv",
            "snakemake --cores 2 tradeoffs",
            _tradeoffs,
        ),
        "truth": ("On real data", "truth/truth.csv", "make truth", _truth),
        "bench": ("Beside peers and published ways", "bench/bench.json", "make bench", _bench),
    }
    return {
        name: f"# {title}\n\n" + _body(results / file, file, command, body)
        for name, (title, file, command, body) in pages.items()
    }


def _body(path: Path, file: str, command: str, body: Callable[[Path], str]) -> str:
    if not path.is_file():
        return (
            f"Not measured here: `results/{file}` was not there when this site was built.\n"
            f"`{command}` makes it; `make docs` then fills this page.\n"
        )
    return f"From `results/{file}`, which `{command}` made on this machine.\n\n{body(path)}"


def _tradeoffs(path: Path) -> str:
    """One table a job and knob; the default is bold."""
    frame = pd.read_csv(path)
    parts = [
        "[How to read it](../evidence/accuracy-vs-time.md#how-to-read-it). Processor time is"
        " comparable within a table.\n\n"
    ]
    for job, of_job in frame.groupby("job", sort=False):
        parts.append(f"## {str(job).capitalize()}\n\n")
        for knob, rows in of_job.groupby("knob", sort=False):
            parts.append(f"### {knob}\n\n{plain_table(rows.to_dict('records'))}\n")
    return "".join(parts)


def published_page(studies: Path) -> str:
    """Markdown of what the studies printed of costs and accuracies.

    Parameters
    ----------
    studies : ``config/tradeoffs.yaml``.
    """
    content = read_yaml(studies)
    parts = [
        "# What the studies published\n\nAs printed, from `config/tradeoffs.yaml`. The same is"
        " varied here ([measured](tradeoffs.md)), and stages stand beside ours in"
        " [beside peers](bench.md).\n\n"
    ]
    for study in content["studies"].values():
        if printed := study.get("published"):
            source = f"{code(study['knob'])}. {printed['source'].rstrip('.')}"
            parts.append(f"## {escaped(study['title'])}\n\n{source}.\n\n")
            rows = [[escaped(str(cell)) for cell in row] for row in printed["rows"]]
            parts.append(table(printed["columns"], rows))
    parts.append("## Stages of the pole job\n\nPole paper, Table 4.\n\n")
    parts.append(_stage_table(content["published_stages"]))
    return "".join(parts)


def _stage_table(stages: list[dict[str, Any]]) -> str:
    head = ("Stage", "min/mile", "Cores", "GPU", "Core-minutes a mile", "Rules that do the same")
    rows = [
        (
            stage["title"],
            _number(stage["minutes_per_mile"]),
            str(stage["cores"]),
            "yes" if stage.get("gpu") else "",
            _number(stage["minutes_per_mile"] * stage["cores"]),
            ", ".join(map(code, stage["rules"])),
        )
        for stage in stages
    ]
    return table(head, rows, right=(1, 2, 4))


def _truth(path: Path) -> str:
    frame = pd.read_csv(path)
    parts = []
    for name, area in AREAS.items():
        rows = frame[frame["area"] == name]
        if rows.empty:
            continue
        parts.append(f"## {escaped(area.title)}\n\n")
        missing = rows.loc[rows["metric"] == "missing", "dataset"]
        if len(missing):
            parts.append(f"Not there: {', '.join(map(code, missing))}.\n\n")
        for metric, figures in rows[rows["metric"] != "missing"].groupby("metric", sort=False):
            unit = figures["unit"].iloc[0]
            parts.append(f"### {words(str(metric)).capitalize()}, {unit}\n\n")
            parts.append(_truth_table(figures))
    return "".join(parts)


def _truth_table(figures: pd.DataFrame) -> str:
    head = ("Data set", "Ours", "Peer", "Peer's name", "Published", "Goal", "CPU s")
    rows = [_truth_row(row) for row in figures.to_dict("records")]
    return table(head, rows, right=(1, 2, 4, 6))


def _truth_row(row: Mapping[Any, Any]) -> tuple[str, ...]:
    goal = _text(row["goal"])
    kept = holds(_float(row["ours"]), goal)
    verdict = "" if kept is None else " (kept)" if kept else " (missed)"
    name = words(str(row["dataset"]))
    return (
        f"**{name}**" if row["dataset"] == MEAN else name,
        _number(row["ours"]),
        _number(row["peer"]),
        escaped(_text(row["peer_name"])),
        _number(row["published"]),
        escaped(goal) + verdict,
        _number(row["cpu_s"]),
    )


def _bench(path: Path) -> str:
    rows = json.loads(path.read_text("utf-8"))
    peers = [row for row in rows if not is_bound(row)]
    bounds = [row for row in rows if is_bound(row)]
    parts = [
        "Ratio: CPU time of the other way over ours, so that more than 1 is faster than the"
        " other way.\n\n## Peers and published ways\n\n",
        _bench_table(peers),
        "## Bounds\n\nWhat nothing can be faster than; 1 would reach it.\n\n" if bounds else "",
        _bench_table(bounds) if bounds else "",
    ]
    return "".join(parts)


def _bench_table(rows: list[dict[str, Any]]) -> str:
    head = (
        *("Kernel", "Workload", "Beside", "CPU s", "Its CPU s", "Ratio", "Ratio by the clock"),
        *("MiB", "Its MiB", "Agreement"),
    )
    cells = [
        (
            escaped(str(row["kernel"])),
            escaped(str(row["workload"])),
            escaped(str(row["against"]).removeprefix(BOUND)),
            _number(row["cpu_s_ours"]),
            _number(row["cpu_s_against"]),
            _number(row["ratio"]),
            _by_the_clock(row),
            _number(row["peak_mib_ours"]),
            _number(row["peak_mib_against"]),
            f"{_number(row['agreement'])} {escaped(_text(row['agreement_metric']))}".strip(),
        )
        for row in rows
    ]
    return table(head, cells, right=range(3, 9))


def _by_the_clock(row: Mapping[str, Any]) -> str:
    """Quotient of both times by the clock, where threads make it another than that of CPU times."""
    if "wall_s_ours" not in row:
        return ""
    return _number(row["wall_s_against"] / max(row["wall_s_ours"], _ROUNDING))


def _float(value: Any) -> float:
    return math.nan if value is None or value == "" else float(value)


def _number(value: Any) -> str:
    """Value to three digits, whole from a thousand."""
    number = _float(value)
    if math.isnan(number):
        return _NONE
    number = 0.0 if abs(number) < _ROUNDING else number
    return f"{number:,.3g}" if abs(number) < 1000 else f"{number:,.0f}"


def _text(value: Any) -> str:
    return "" if value is None or value != value else str(value)  # noqa: PLR0124
