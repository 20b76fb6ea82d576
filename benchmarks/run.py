"""All side-by-side benchmarks: ``make bench`` writes ``results/bench/bench.json`` and a table."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

PROGRAMS = ("bench_scene", "bench_lidar", "bench_raster", "bench_alignment", "bench_cover")


def main() -> None:
    """Run the programs and print one line per kernel."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="small workloads, for tests")
    parser.add_argument("--only", choices=PROGRAMS, help="one program")
    arguments = parser.parse_args()
    rows = []
    for name in [arguments.only] if arguments.only else PROGRAMS:
        rows += importlib.import_module(name).rows(arguments.quick)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(rows, indent=2) + "\n")
    print(f"\n{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    for row in rows:
        print(
            f"{row['kernel']:36} {row['cpu_s_ours']:9.3f} s against {row['against']:28}"
            f" {row['cpu_s_against']:9.3f} s  ratio {row['ratio']:7.3g}"
            f"  {row['agreement_metric']} {row['agreement']}"
        )


if __name__ == "__main__":
    main()
