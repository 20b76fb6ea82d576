"""Open3D, where it can be loaded."""

from __future__ import annotations

import pytest

from roadsight.base.engines import open3d
from roadsight.base.errors import InputError


@pytest.fixture(scope="session")
def o3d():
    try:
        return open3d()
    except InputError as error:
        pytest.skip(str(error))
