"""Open3D, where it can be loaded."""

from typing import Any

import pytest

from roadsight.base.engines import open3d
from roadsight.base.errors import InputError


def needs_open3d() -> Any:
    """The module; a test that needs it is skipped where it cannot be loaded."""
    try:
        return open3d()
    except InputError as error:
        pytest.skip(str(error))
