"""Compiled kernels: parts that a test calls, and those that go along where it copies the project.

Compiling them takes minutes. Numba names the folders of a cache by the path of the sources and
judges them by their content, so that kernels of one checkout fit another that has the same sources,
in folders of other names.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

from numba import njit
from numba.core.caching import UserProvidedCacheLocator

from roadsight.config.environment import kernel_cache

_PACKAGE = Path("workflow/roadsight")


def bring_kernels(source: Path, target: Path) -> None:
    """Copy what one checkout has compiled into the cache of another, if it has any."""
    named = UserProvidedCacheLocator.get_suitable_cache_subpath
    there, here = kernel_cache(source), kernel_cache(target)
    for folder in {path.parent for path in (source / _PACKAGE).rglob("*.py")}:
        relative = folder.relative_to(source)
        compiled = there / named(source / relative / "module.py")
        if compiled.is_dir():
            new = here / named(target / relative / "module.py")
            shutil.copytree(compiled, new, dirs_exist_ok=True)


def from_python(part: Callable) -> Callable:
    """A kernel that does what a `compiled_part` does, which Python cannot call."""

    @njit
    def call(*given):
        return part(*given)

    return call
