"""Which library does a step: this package itself, or Open3D where a user asks for it."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import sys
from typing import Any, Literal, get_args

from roadsight.base.errors import InputError

Engine = Literal["own", "open3d"]  # who does a step
# The default everywhere, so that results do not depend on what a machine has installed.
OWN: Engine = "own"
ENGINES: tuple[str, ...] = get_args(Engine)  # all engines, for command lines
# Debian's package of each system library that a wheel of Open3D 0.19 or 0.20 is linked with and
# does not bring along (``ldd`` of all its libraries; libgomp belongs to 0.19).
SYSTEM_PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libudev.so.1": "libudev1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


def open3d(where: str = "") -> Any:
    """The module ``open3d``.

    Parameters
    ----------
    where : setting that asks for it, for the message.

    Raises
    ------
    InputError : it is not installed, or a system library is missing; names the packages.
    """
    if not is_installed():
        raise InputError(
            "the engine open3d is not installed",
            where=where,
            found="no Python package open3d-cpu",
            allowed="engine: own, which needs nothing more",
            hint="install envs/requirements-open3d.lock (docs/howto/engines.md)",
        )
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        missing = missing_libraries()
        packages = " ".join(sorted(SYSTEM_PACKAGES[name] for name in missing))
        raise InputError(
            "the engine open3d cannot be loaded",
            where=where,
            found=f"missing {', '.join(missing)}" if missing else str(error),
            allowed="engine: own, which needs nothing more",
            hint=f"on Debian: apt-get install {packages}"
            if missing
            else "install envs/requirements-open3d.lock anew",
        ) from error


def is_installed() -> bool:
    """Whether Open3D's package is here; whether it can be loaded, `is_usable` tells."""
    return importlib.util.find_spec("open3d") is not None


def is_usable() -> bool:
    """Whether Open3D can be loaded.

    It is loaded, which takes a second, only where a library is missing: not all versions need all.
    """
    if not is_installed():
        return False
    if not missing_libraries():
        return True
    try:
        open3d()
    except InputError:
        return False
    return True


def missing_libraries() -> list[str]:
    """System libraries among `SYSTEM_PACKAGES` that cannot be loaded here."""
    return [name for name in SYSTEM_PACKAGES if not _loads(name)]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def main() -> int:
    """Tell after an installation whether Open3D can be loaded; exit code 0 or 1."""
    try:
        open3d()
    except InputError as error:
        print(f"roadsight: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
