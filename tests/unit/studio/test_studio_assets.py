import json
import re

import pytest

from roadsight.studio.server import ASSETS

MODULES = [p for p in sorted(ASSETS.rglob("*.js")) if "vendor" not in p.relative_to(ASSETS).parts]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ASSETS)))
def test_modules_are_small_and_import_what_is_there(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 300
    for name in re.findall(r'(?:from|import)\s*\(?\s*"([^"]+)"', text):
        assert name.startswith("."), f"{name} comes from elsewhere"
        assert (path.parent / name).resolve().is_file(), f"{name} is not there"


def test_no_file_names_an_address_elsewhere():
    for path in [*MODULES, *ASSETS.glob("*.css"), *ASSETS.glob("*.html")]:
        found = re.findall(r"https?://[^\s\"')]+", path.read_text(encoding="utf-8"))
        assert [one for one in found if "www.w3.org" not in one] == [], path


def test_what_is_bundled_is_the_locked_version(project):
    wanted = json.loads((project / "web/package.json").read_text())["dependencies"]["three"]
    locked = json.loads((project / "web/package-lock.json").read_text())
    assert locked["packages"]["node_modules/three"]["version"] == wanted
    revision = wanted.split(".")[1]
    bundle = (ASSETS / "vendor/three.js").read_text(encoding="utf-8")
    assert (
        f'"{revision}"' in bundle and "Copyright" in (ASSETS / "vendor/three.LICENSE").read_text()
    )
