import os
import subprocess
import sys
from pathlib import Path

import pytest

fcntl = pytest.importorskip("fcntl")

MODULE = """\
from roadsight.base.kernels import compiled


@compiled()
def total(values):
    found = 0.0
    for value in values:
        found += value
    return found
"""
USER = """\
import sys
import numpy as np
from shared_kernel import total

print("ready", flush=True)
assert total(np.arange(4.0)) == 6.0
print(sum(total.stats.cache_misses.values()))
"""
PROCESSES = 3


def test_one_process_compiles_and_the_others_read_what_it_kept(tmp_path):
    (tmp_path / "shared_kernel.py").write_text(MODULE)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    cache = tmp_path / "cache"
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache)}
    # Whoever holds the lock keeps all of them waiting: they then begin together.
    folder = subprocess.run(
        [sys.executable, "-c", "from shared_kernel import total; print(total._cache.cache_path)"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    Path(folder).mkdir(parents=True, exist_ok=True)
    with (Path(folder) / "shared_kernel.total.lock").open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        started = [
            subprocess.Popen(
                [sys.executable, "-c", USER], env=environment, stdout=subprocess.PIPE, text=True
            )
            for _ in range(PROCESSES)
        ]
        for process in started:
            assert process.stdout.readline() == "ready\n"
    compiled = [int(process.communicate(timeout=120)[0]) for process in started]
    assert [process.returncode for process in started] == [0] * PROCESSES
    assert sorted(compiled) == [0] * (PROCESSES - 1) + [1]
