"""Fixtures that all tests share: seeded randomness, data folder, tiny analytic ground scenes."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from numpy.typing import NDArray

from roadsight.config.environment import kernel_cache

Array = NDArray[np.float64]
PROJECT = Path(__file__).resolve().parents[1]

# The same examples in every run, so that a change is judged by what it changes; a search for new
# ones is a run of its own: HYPOTHESIS_PROFILE=search.
_NO_CLOCK = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
"""A machine with other work is slow, which no test is about."""
settings.register_profile("same", derandomize=True, **_NO_CLOCK)
settings.register_profile("search", print_blob=True, **_NO_CLOCK)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))


# Before any test imports Numba: kernels that `make run` has compiled are not compiled again.
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_cache(PROJECT)))


_LONG = {"finished", "finished_road", "browser"}
"""Fixtures of a site that was run to its end, and of a browser: half of all the time."""
_UNGROUPED = "pytest-xdist does not group tests under this pytest: install the locked versions"


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> Generator[None]:
    """What needs a finished site or a browser is part of `make test-full` only.

    Groups of tests share what takes minutes to make: say so if pytest-xdist ignores them.
    """
    for item in items:
        if _LONG & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.full)
    yield
    if config.getoption("loadgroup", default=False):
        for item in items:
            if any(item.iter_markers("xdist_group")) and "@" not in item.nodeid:
                raise pytest.UsageError(_UNGROUPED)


@pytest.fixture
def project() -> Path:
    """Root of the checkout."""
    return PROJECT


@pytest.fixture
def rng() -> np.random.Generator:
    """Randomness that is the same in every run."""
    return np.random.default_rng(20_240_611)


@pytest.fixture
def data() -> Path:
    """Folder of the real data sets; the test is skipped where there is none."""
    folder = os.environ.get("ROADSIGHT_DATA")
    if not folder:
        pytest.skip("ROADSIGHT_DATA is not set: the real data sets are needed")
    return Path(folder)


@pytest.fixture
def cases() -> Path:
    """Folder of awkward files of users; the test is skipped where there is none."""
    folder = os.environ.get("ROADSIGHT_CASES")
    if not folder or not Path(folder).is_dir():
        pytest.skip("ROADSIGHT_CASES is not set: the awkward files are needed")
    return Path(folder)


@dataclass(frozen=True)
class GroundScene:
    """Points whose ground is known: xyz_m (n, 3), ground (n,), and the surface's formula."""

    xyz_m: Array
    ground: NDArray[np.bool_]
    surface: Callable[[Array, Array], Array]

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        low, high = self.xyz_m[:, :2].min(axis=0), self.xyz_m[:, :2].max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def with_objects(self, *objects: Array, hidden: Callable | None = None) -> GroundScene:
        """Scene with points that are not ground; ``hidden(x, y)`` says where ground has none."""
        keep = np.ones(len(self.xyz_m), bool)
        if hidden is not None:
            keep = ~(hidden(self.xyz_m[:, 0], self.xyz_m[:, 1]) & self.ground)
        xyz = np.concatenate([self.xyz_m[keep], *objects])
        ground = np.zeros(len(xyz), bool)
        ground[: keep.sum()] = self.ground[keep]
        return GroundScene(xyz, ground, self.surface)


@pytest.fixture
def plane_scene(rng: np.random.Generator) -> Callable[..., GroundScene]:
    """Builder of a plane: side_m, points per m2, slopes along x and y, noise (1 sigma)."""

    def build(
        side_m: float = 40.0,
        density_m2: float = 40.0,
        slope_x: float = 0.0,
        slope_y: float = 0.0,
        noise_m: float = 0.01,
    ) -> GroundScene:
        def surface(x: Array, y: Array) -> Array:
            return 3.0 + slope_x * x + slope_y * y

        x, y = rng.uniform(0, side_m, (2, int(density_m2 * side_m**2)))
        z = surface(x, y) + rng.normal(0, noise_m, len(x))
        return GroundScene(np.column_stack([x, y, z]), np.ones(len(x), bool), surface)

    return build


@pytest.fixture
def box_shell(rng: np.random.Generator) -> Callable[..., Array]:
    """Builder of the visible sides and top of a box: x, y, z ranges, points per m2."""

    def build(
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        density_m2: float = 40.0,
    ) -> Array:
        low, high = np.array([x[0], y[0], z[0]]), np.array([x[1], y[1], z[1]])
        faces = []
        for axis, value in ((0, x[0]), (0, x[1]), (1, y[0]), (1, y[1]), (2, z[1])):
            area = np.prod(np.delete(high - low, axis))
            face = rng.uniform(low, high, (int(np.ceil(area * density_m2)), 3))
            face[:, axis] = value
            faces.append(face)
        return np.concatenate(faces)

    return build
