"""The way from the terminal into the browser, and sites with unusual names."""

import signal
import stat
import time
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml

from tests.e2e.studio_project import Studio, make_project

pytestmark = pytest.mark.xdist_group("studio")
NAMED = "my road (2)"


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studio")
    project = make_project(folder / "project", poles=False)
    site = yaml.safe_load((project / "config/sites/tiny.yaml").read_text())
    (project / f"config/sites/{NAMED}.yaml").write_text(yaml.safe_dump(site))
    program = folder / "browser"
    program.write_text(f'#!/bin/sh\necho "$@" > "{folder}/told.part"\n'
                       f'mv "{folder}/told.part" "{folder}/told"\n')  # fmt: skip
    program.chmod(0o755)
    with Studio(project, folder / "log", program) as started:
        end = time.monotonic() + 30
        while not (folder / "told").exists() and time.monotonic() < end:
            time.sleep(0.05)
        started.told = (folder / "told").read_text().strip()
        yield started


def test_the_token_is_in_no_argument_and_the_browser_still_finds_in(browser, studio):
    token = studio.address.partition("token=")[2]
    assert len(token) > 20 and token not in studio.told
    page = Path(unquote(urlsplit(studio.told).path))
    assert stat.S_IMODE(page.stat().st_mode) == 0o600 and token in page.read_text()
    browser.open(studio.told)
    browser.until("window.studio?.page")
    assert browser.complaints == []


def test_sites_with_blanks_in_their_names_open(browser, studio):
    browser.open(studio.address)
    browser.until("window.studio?.page")
    browser.run(f"""(() => {{
        const list = document.getElementById('site');
        list.value = {NAMED!r};
        list.onchange();
    }})()""")
    browser.until(f"document.title.includes({NAMED!r}) && studio.page")
    browser.run("document.querySelector('#tabs a[href^=\\'#/run\\']').click()")
    browser.until(f"document.title.startsWith('Run · ' + {NAMED!r}) && studio.page")
    browser.reload()
    browser.until(f"document.title.startsWith('Run · ' + {NAMED!r}) && studio.page")


def test_the_page_that_leads_in_goes_with_the_studio(studio):
    page = Path(unquote(urlsplit(studio.told).path))
    studio.process.send_signal(signal.SIGINT)
    assert studio.process.wait(20) == 0
    assert not page.exists()
