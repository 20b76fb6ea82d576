"""The environment in which stages run."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from roadsight.io.sources import package_digest

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def prepare_environment() -> None:
    """Set what stages inherit.

    They run with the interpreter that runs Snakemake, whether or not its environment is active.
    Kernels are single-threaded by design; shards are what runs in parallel. Numba notices an edit
    in a kernel's own file only, not in the kernels that it calls: its cache is kept by the digest
    of all sources.
    """
    folder = str(Path(sys.executable).parent)
    os.environ["PATH"] = f"{folder}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    for variable in _THREADS:
        os.environ.setdefault(variable, "1")
    cache = f".snakemake/roadsight/numba-{package_digest()}"
    os.environ["NUMBA_CACHE_DIR"] = str(Path(cache).resolve())
