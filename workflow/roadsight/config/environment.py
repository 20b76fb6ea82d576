"""The environment in which stages run."""

from __future__ import annotations

import marshal
import os
import sys
from pathlib import Path

from roadsight.io.records.sources import package_digest

_PYC_HEADER_BYTES = 16  # what comes before the code in a compiled module (PEP 552)
# What says how many threads each library starts.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS")
_ALLOCATION = {
    # Arrow takes memory from where NumPy does, so that each uses again what the other has freed.
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    # Large pages, see `docs/decisions/050-what-bounds-a-corridor.md`.
    "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
    # Bytes from which an array gets pages of its own, which go back as soon as it is freed.
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
    # Bytes that a stage keeps when they are freed.
    "MALLOC_TRIM_THRESHOLD_": str(2**28),
}


def prepare_environment() -> None:
    """Set what stages inherit.

    They run with the interpreter that runs Snakemake, whether or not its environment is active.
    Kernels are single-threaded by design; shards are what runs in parallel, and the rules of the
    few steps that all others wait for ask for threads. New pages of memory are dear on virtual
    machines: arrays up to 32 MiB come from memory that a stage has had before, and what is new
    comes in large pages. Numba notices an edit in a kernel's own file only, not in the
    kernels that it calls: its cache is kept by the digest of all sources.
    """
    drop_damaged_bytecode(Path(__file__).parents[1])
    folder = str(Path(sys.executable).parent)
    os.environ["PATH"] = f"{folder}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    for variable, value in (dict.fromkeys(_THREADS, "1") | _ALLOCATION).items():
        os.environ.setdefault(variable, value)
    os.environ["NUMBA_CACHE_DIR"] = str(kernel_cache(Path()).resolve())


def kernel_cache(root: Path) -> Path:
    """Where a project keeps what is compiled of this package's sources."""
    return root / f".snakemake/roadsight/numba-{package_digest()}"


def drop_damaged_bytecode(package: Path) -> None:
    """Remove compiled modules below ``package`` that cannot be loaded.

    Python before 3.12.8 keeps what a full disk cut off under its name, and every later import of
    that module fails.
    """
    for path in package.rglob("*.pyc"):
        try:
            marshal.loads(path.read_bytes()[_PYC_HEADER_BYTES:])
        except (EOFError, TypeError, ValueError):
            path.unlink(missing_ok=True)
        except OSError:
            continue
