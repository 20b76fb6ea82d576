"""All side-by-side benchmarks: ``make bench`` writes ``results/bench/bench.json`` and a page."""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import sys
from pathlib import Path
from typing import get_args

sys.path.insert(0, str(Path(__file__).parent))
from roadsight.config.environment import prepare_environment
from roadsight.report.files import read_assets

prepare_environment()

from bench_measure import Size  # noqa: E402  # the number of threads is settled before
from bench_page import ASSETS, render_bench  # noqa: E402
from roadsight import __version__  # noqa: E402
from roadsight.io.records.atomic import write_json  # noqa: E402

PROGRAMS = (
    "bench_scene",
    "bench_lidar",
    "bench_depth_models",
    "bench_raster",
    "bench_alignment",
    "bench_cover",
    "bench_jobs",
)


def main() -> None:
    """Run the programs, print one line per kernel and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", choices=get_args(Size), default="usual", help="workloads")
    parser.add_argument("--only", choices=PROGRAMS, help="one program")
    arguments = parser.parse_args()
    rows = []
    for name in [arguments.only] if arguments.only else PROGRAMS:
        rows += importlib.import_module(name).rows(arguments.size)
        write_json(arguments.out, rows)  # what is there stays, whatever comes next
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    page = arguments.out.with_name("index.html")
    page.write_text(render_bench(rows, _assets(), __version__, machine), encoding="utf-8")
    print(f"\n{machine}; page: {page}")
    for row in rows:
        print(
            f"{row['kernel']:36} {row['cpu_s_ours']:9.3f} s against {row['against']:28}"
            f" {row['cpu_s_against']:9.3f} s  ratio {row['ratio']:7.3g}"
            f"  {row['agreement_metric']} {row['agreement']}"
        )


def _assets() -> dict[str, str]:
    return read_assets(ASSETS)


if __name__ == "__main__":
    main()
