"""Open3D, where it can be loaded."""

import pytest

from tests.helpers.engines import needs_open3d


@pytest.fixture(scope="session")
def o3d():
    return needs_open3d()
