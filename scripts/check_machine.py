"""Check, before anything is installed, that this machine can run roadsight; stdlib only.

``check_machine.py open3d`` asks instead whether the wheel of Open3D fits: exit code 0, or 1 and one
line that says why not.
"""

from __future__ import annotations

import ctypes.util
import platform
import sys

_GLIBC = (2, 35)
"""glibc that the wheels of open3d-cpu 0.20 are built for (their tag manylinux_2_35)."""
_PYTHONS = ((3, 11), (3, 14))
"""From the oldest CPython that we support to the first that we do not."""


def problems() -> list[str]:
    """What stands in the way of an installation."""
    found = []
    if not _PYTHONS[0] <= sys.version_info[:2] < _PYTHONS[1]:
        found.append(
            f"Python {platform.python_version()} found, 3.11 to 3.13 needed;"
            " install one and run `make run PYTHON=python3.12`"
        )
    if sys.platform == "linux" and platform.libc_ver()[0] != "glibc":
        found.append("this system has no glibc, which the binary packages need")
    try:
        import ensurepip  # noqa: F401, PLC0415
        import venv  # noqa: F401, PLC0415
    except ImportError:
        found.append("the venv module is missing; on Debian: apt-get install python3-venv")
    if sys.platform == "linux" and not ctypes.util.find_library("stdc++"):
        found.append("the C++ runtime is missing; on Debian: apt-get install libstdc++6")
    return found


def why_no_open3d() -> str:
    """Why the wheel of Open3D does not fit this machine; nothing where it does."""
    if platform.python_implementation() != "CPython":
        return f"its wheels are for CPython, this is {platform.python_implementation()}"
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return f"its wheels are for Linux on x86_64, this is {sys.platform} {platform.machine()}"
    name, version = platform.libc_ver()
    numbers = tuple(int(part) for part in version.split(".")[:2] if part.isdigit())
    if name != "glibc" or numbers < _GLIBC:
        needed = ".".join(map(str, _GLIBC))
        return f"its wheels need glibc {needed}, this is {name or 'no glibc'} {version}".rstrip()
    return ""


def main(arguments: list[str]) -> int:
    """Exit code; what is wrong goes to standard error."""
    if arguments == ["open3d"]:
        reason = why_no_open3d()
        if reason:
            print(f"Open3D is left out, {reason}; all results come without it", file=sys.stderr)
        return int(bool(reason))
    found = problems()
    if found:
        print("roadsight cannot be installed here:", *found, sep="\n  ", file=sys.stderr)
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
