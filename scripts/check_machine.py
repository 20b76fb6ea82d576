"""Check, before anything is installed, that this machine can run roadsight; stdlib only."""

import ctypes.util
import platform
import sys

PROBLEMS = []

if not (3, 11) <= sys.version_info[:2] < (3, 14):
    PROBLEMS.append(
        f"Python {platform.python_version()} found, 3.11 to 3.13 needed;"
        " install one and run `make run PYTHON=python3.12`"
    )
if sys.platform == "linux" and platform.libc_ver()[0] != "glibc":
    PROBLEMS.append("this system has no glibc, which the binary packages need")
try:
    import ensurepip  # noqa: F401
    import venv  # noqa: F401
except ImportError:
    PROBLEMS.append("the venv module is missing; on Debian: apt-get install python3-venv")
if sys.platform == "linux" and not ctypes.util.find_library("stdc++"):
    PROBLEMS.append("the C++ runtime is missing; on Debian: apt-get install libstdc++6")

if PROBLEMS:
    sys.exit("roadsight cannot be installed here:\n  " + "\n  ".join(PROBLEMS))
