"""What tests do to the studio's pages: open, keys, clicks, drags, texts and looks."""

from pathlib import Path

HELPERS = Path(__file__).with_name("report_page.js").read_text(encoding="utf-8")
SIZES = ((1280, 720), (1600, 1000), (390, 844))
LOOKS = [(*size, dark) for size in SIZES for dark in (False, True)]


def open_studio(browser, studio, place="", ready="studio.page"):
    """The studio at a place, such as ``results/tiny``, as somebody opens it for the first time."""
    browser.complaints.clear()
    set_size(browser, 1280, 720)
    # From a page that keeps nothing: what the last one wrote as it left is there by now.
    root, _, token = studio.address.partition("/#token=")
    browser.open(f"{root}/assets/icon.svg")
    browser.run("localStorage.clear()")
    if place:
        browser.run(f"localStorage.setItem('roadsight-token', {token!r})")
    browser.open(f"{root}/#/{place}" if place else studio.address)
    browser.until(f"window.studio && ({ready})")
    return browser


def set_size(page, width, height):
    """Size of the window, px."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    page.call("Emulation.setDeviceMetricsOverride", **size)


def key(page, name, modifiers=0, code=""):
    """Press a key."""
    text = name if len(name) == 1 and not modifiers else ""
    event = {"key": name, "modifiers": modifiers, "code": code}
    if name == "Escape":
        event["windowsVirtualKeyCode"] = 27  # by which the browser itself closes a dialog
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


def click_at(page, u, v, count=1, modifiers=0):
    """Click a place of the window, px."""
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, x=u, y=v, button="left",
            clickCount=count, modifiers=modifiers,
        )  # fmt: skip


def drag(page, start, end, modifiers=0):
    """Drag from one place of the window to another, px."""
    held = {"button": "left", "buttons": 1, "clickCount": 1, "modifiers": modifiers}
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=start[0], y=start[1])
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], **held)
    for share in (0.5, 1.0):
        u, v = (a + share * (b - a) for a, b in zip(start, end, strict=True))
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=u, y=v, **held)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], **held)


def press(page, label):
    """Click the button that says so."""
    page.run(f"""(() => {{
        const found = [...document.querySelectorAll('button')]
            .find((one) => one.textContent.startsWith({label!r}) && one.offsetParent);
        if (!found || found.disabled) throw new Error('no such button: ' + {label!r});
        found.click();
    }})()""")


def hold_back(page, method, ending):
    """Keep back such requests of the page from now on, until ``release()`` is run in it."""
    page.run(f"""(() => {{
        const {{ fetch }} = window;
        const gate = new Promise((resolve) => {{ window.release = resolve; }});
        window.fetch = async (url, options) => {{
            if ((options?.method ?? 'GET') === {method!r} && String(url).endsWith({ending!r})) {{
                window.held = String(url);
                await gate;
            }}
            return fetch(url, options);
        }};
    }})()""")


def noted(page, note):
    """Wait until a note says so."""
    page.until(f"document.getElementById('notes').textContent.includes({note!r})")


def check_look(page, width, height, dark):
    """Texts stand out, and nothing is cut off at this size of the window."""
    set_size(page, width, height)
    if page.run("document.documentElement.dataset.theme === 'dark'") != dark:
        page.run("document.getElementById('theme').click()")
    page.run(HELPERS)
    assert page.run("faintTexts()") == []
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    assert page.run("document.documentElement.scrollHeight <= innerHeight")
