"""One browser a module, without anything remembered from another."""

from __future__ import annotations

import pytest
from chromium import BINARY, Chromium


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if BINARY is None:
        pytest.skip("no Chromium to open pages with")
    with Chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started
