"""One browser a module, without anything remembered from another."""

import shutil

import pytest

from tests.e2e.chromium import BINARY, Chromium
from tests.e2e.studio_project import Studio, make_project


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if BINARY is None:
        pytest.skip("no Chromium to open pages with")
    with Chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A studio on a project without poles; modules that need another have their own."""
    folder = tmp_path_factory.mktemp("studio")
    with Studio(make_project(folder / "project", poles=False), folder / "log") as started:
        yield started


@pytest.fixture
def project(studio):
    """The project with nothing drawn yet."""
    file = studio.folder / "config/sites/tiny.yaml"
    before = file.read_bytes()
    yield studio.folder
    file.write_bytes(before)
    shutil.rmtree(file.with_suffix(""), ignore_errors=True)


@pytest.fixture
def page(request, browser, report):
    """A module's report in the light theme, as the module opens it."""
    return request.module.opened(browser, report)


@pytest.fixture(params=[False, True], ids=["light", "dark"])
def themed(request, browser, report):
    """A module's report in either theme."""
    browser.set_theme(request.param)
    yield request.module.opened(browser, report)
    browser.set_theme(False)
