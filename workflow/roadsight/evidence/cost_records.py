"""What finished runs needed, read from their results, logs and benchmark files."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from roadsight.base.errors import InputError
from roadsight.evidence.costs import STEPS, STORED, Amounts, Record
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.io.records.usage import last_usage

_SIDES = ("left_path", "right_path")
"""Columns of side views, which are images of their own."""


def read_amounts(site: Path) -> Amounts:
    """What the run of a site worked through, from its results.

    Raises
    ------
    InputError : it has none, or one cannot be read.
    """
    frame = site / "scene/frame.json"
    if not frame.is_file():
        raise InputError("holds no results of a site", where=str(site), allowed="results/<site>")
    rounds = sorted((site / "placement").glob("round-*"))
    masks = list((site / "poles/masks").glob("*.zip"))
    first = list((site / "placement/round-0/depth").glob("*/*.parquet"))
    sensors = {path.parent.name for path in first}
    candidates = [len(read_table(r / "candidates.parquet", ["candidate"])) for r in rounds]
    targets = site / "placement/targets.parquet"
    return Amounts(
        points_m=read_json(frame)["points"] / 1e6,
        candidates=sum(candidates),
        sensors=len(sensors),
        targets=len(read_table(targets)) if targets.is_file() else 0,
        plans=len(list((site / "placement").glob("*/solution.json"))),
        images=_images(site / "poles/frames.parquet"),
        shards=max(len(masks), len(first) // max(len(sensors), 1), 1),
        rounds=max(len(rounds), 1),
    )


def _images(frames: Path) -> int:
    """Images of a videolog with their side views."""
    if not frames.is_file():
        return 0
    table = read_table(frames)
    return len(table) + sum(int((table[name] != "").sum()) for name in _SIDES if name in table)


def read_records(site: Path) -> list[Record]:
    """One record for each step of a site.

    Parameters
    ----------
    site : ``results/<site>``; logs are sought in ``logs/<site>`` beside ``results``.
    """
    amounts = read_amounts(site)
    found: dict[str, list[tuple[float, float]]] = {}
    for file in sorted((site / "benchmarks").rglob("*.tsv")):
        if file.stem in STEPS:
            found.setdefault(file.stem, []).append(_usage(site, file))
    records = []
    for step, usages in found.items():
        cpu_s = sum(cpu for cpu, _ in usages)
        peaks = [peak for _, peak in usages if peak > 0]
        units = amounts.units(STEPS[step].driver)
        peak = max(peaks, default=float("nan"))
        records.append(Record(site.name, step, len(usages), units, cpu_s, peak))
    return records


def _usage(site: Path, benchmark: Path) -> tuple[float, float]:
    """Processor seconds and peak MiB of a job: by its log, else by its benchmark file."""
    inside = benchmark.relative_to(site / "benchmarks").with_suffix(".log")
    usage = last_usage(site.parents[1] / "logs" / site.name / inside)
    if usage is not None:
        return usage.cpu_s, usage.peak_mib
    row = pd.read_csv(benchmark, sep="\t").apply(pd.to_numeric, errors="coerce").iloc[0]
    return float(row.get("cpu_time", 0.0) or 0.0), float(row.get("max_rss", 0.0) or 0.0)


def read_stored(site: Path) -> dict[str, int]:
    """Bytes of each kind of result of a site, by the deepest folder of `STORED` that holds it."""
    sizes = dict.fromkeys(STORED, 0)
    for path in site.rglob("*"):
        name = path.relative_to(site).as_posix()
        kinds = [kind for kind in STORED if name.startswith(f"{kind}/")]
        if kinds and path.is_file():
            sizes[max(kinds, key=len)] += path.stat().st_size
    return sizes
