"""What the tests of the studio's pages share: a clean page, keys, clicks, and looks."""

from __future__ import annotations

from pathlib import Path

HELPERS = Path(__file__).with_name("report_page.js").read_text(encoding="utf-8")
LOOKS = [(1280, 720, False), (1280, 720, True), (1600, 1000, False), (1600, 1000, True)]


def open_studio(browser, studio, place):
    """Open the studio on one of its pages, with nothing remembered."""
    browser.open("about:blank")
    origin = studio.address.partition("/#")[0]
    browser.call("Storage.clearDataForOrigin", origin=origin, storageTypes="local_storage")
    browser.open(studio.address)
    browser.until("window.studio?.project")
    browser.run(f"location.hash = '#/{place}'")
    browser.until(f"studio.page && location.hash === '#/{place}'")
    browser.complaints.clear()
    return browser


def key(page, name, modifiers=0, code=""):
    """Press a key."""
    text = name if len(name) == 1 and not modifiers else ""
    event = {"key": name, "modifiers": modifiers, "code": code}
    page.call("Input.dispatchKeyEvent", type="keyDown", text=text, **event)
    page.call("Input.dispatchKeyEvent", type="keyUp", **event)


def click(page, selector):
    """Click an element that must be there and enabled."""
    page.until(f"document.querySelector({selector!r})")
    assert page.run(f"document.querySelector({selector!r}).disabled") is not True
    page.run(f"document.querySelector({selector!r}).click()")


def text(page, selector="main"):
    """Text of an element."""
    return page.run(f"document.querySelector({selector!r})?.textContent ?? ''")


def check_look(page, width, height, dark):
    """Texts stand out and nothing is cut off, in one theme and size."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    page.call("Emulation.setDeviceMetricsOverride", **size)
    if page.run("document.documentElement.dataset.theme === 'dark'") != dark:
        page.run("document.getElementById('theme').click()")
    page.run(HELPERS)
    assert page.run("faintTexts()") == []
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    assert page.run("document.documentElement.scrollHeight <= innerHeight")
