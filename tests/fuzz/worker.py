"""Reads damaged files in a process of its own, so that a crash, a hang or greed ends only that.

``python -m tests.fuzz.worker READER FIRST COUNT FOLDER`` prints ``at NUMBER`` before each file,
and ``bad NUMBER REASON`` for what should not be.
"""

import os
import re
import resource
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np

from roadsight.base.errors import InputError
from tests.fuzz.mutate import mutated
from tests.fuzz.readers import READERS, Reader

MEMORY_BYTES = 1 << 30
LONGEST_MESSAGE = 2000


def damaged(reader: Reader, seeds: list[bytes], number: int) -> tuple[str, bytes]:
    """Suffix and content of the file of that number."""
    rng = np.random.default_rng(number)
    suffix = reader.suffixes[rng.integers(len(reader.suffixes))]
    return suffix, mutated(seeds[rng.integers(len(seeds))], rng)


def problem(reader: Reader, path: Path) -> str:
    """What the reader does wrong with a file, or nothing."""
    try:
        reader.read(path)
    except InputError as error:
        message = str(error)
        if "\n" in message or "\r" in message or len(message) > LONGEST_MESSAGE:
            return f"message of {len(message)} characters or several lines: {message[:300]!r}"
    except BaseException:
        lines = traceback.format_exc().splitlines()
        own = [line for line in lines if re.search(r"roadsight/", line)]
        return f"{lines[-1][:300]} | {own[-1].strip() if own else lines[-3].strip()}"
    return ""


def limit_memory() -> None:
    """Leave as much address space as is in use, and a little more."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, resource.RLIM_INFINITY))


def main() -> None:
    name, first, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    warnings.simplefilter("ignore")
    reader = READERS[name]
    folder = Path(tempfile.mkdtemp(dir=sys.argv[4]))
    seeds = reader.seeds(folder)
    for file in folder.iterdir():
        file.unlink()
    for number, content in enumerate(seeds):
        path = folder / f"whole{reader.suffixes[number % len(reader.suffixes)]}"
        path.write_bytes(content)
        problem(reader, path)  # loads what is loaded late, before memory is limited
        path.unlink()
    limit_memory()
    for number in range(first, first + count):
        print(f"at {number}", flush=True)
        suffix, content = damaged(reader, seeds, number)
        path = folder / f"damaged{suffix}"
        path.write_bytes(content)
        if found := problem(reader, path):
            print(f"bad {number} {found!r}", flush=True)
        path.unlink()


if __name__ == "__main__":
    main()
