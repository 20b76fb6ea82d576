"""What tests do to the studio's pages: keys, clicks, drags, buttons by their text."""

from __future__ import annotations

from pathlib import Path

HELPERS = Path(__file__).with_name("report_page.js").read_text(encoding="utf-8")


def open_studio(browser, studio, page, site, ready):
    """The studio on a page, as somebody opens it for the first time."""
    browser.complaints.clear()
    set_size(browser, 1280, 720)
    browser.open("about:blank")
    origin = studio.address.partition("/#")[0]
    browser.call("Storage.clearDataForOrigin", origin=origin, storageTypes="local_storage")
    browser.open(studio.address)
    browser.until("window.studio?.page")
    if page:
        browser.run(f"location.hash = '#/{page}/{site}'")
    browser.until(ready)
    return browser


def set_size(page, width, height):
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    page.call("Emulation.setDeviceMetricsOverride", **size)


def key(page, name, modifiers=0):
    text = name if len(name) == 1 and not modifiers else ""
    event = {"key": name, "modifiers": modifiers}
    page.call("Input.dispatchKeyEvent", type="keyDown", text=text, **event)
    page.call("Input.dispatchKeyEvent", type="keyUp", **event)


def click(page, u, v, count=1, modifiers=0):
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, x=u, y=v, button="left",
            clickCount=count, modifiers=modifiers,
        )  # fmt: skip


def drag(page, start, end, modifiers=0):
    held = {"button": "left", "buttons": 1, "clickCount": 1, "modifiers": modifiers}
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=start[0], y=start[1])
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], **held)
    for share in (0.5, 1.0):
        u, v = (a + share * (b - a) for a, b in zip(start, end, strict=True))
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=u, y=v, **held)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], **held)


def press(page, text):
    """Click the button that says so."""
    page.run(f"""(() => {{
        const found = [...document.querySelectorAll('button')]
            .find((one) => one.textContent.startsWith({text!r}) && one.offsetParent);
        if (!found || found.disabled) throw new Error('no such button: ' + {text!r});
        found.click();
    }})()""")


def noted(page, text):
    """Wait until a note says so."""
    page.until(f"document.getElementById('notes').textContent.includes({text!r})")


def check_looks(page, dark, width, height):
    """Texts stand out, and nothing is cut off at this size of the window."""
    set_size(page, width, height)
    if page.run("document.documentElement.dataset.theme === 'dark'") != dark:
        page.run("document.getElementById('theme').click()")
    page.run(HELPERS)
    assert page.run("faintTexts()") == []
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    assert page.run("document.documentElement.scrollHeight <= innerHeight")
