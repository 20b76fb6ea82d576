"""A headless Chromium, driven over a pipe with its own debugging protocol: no further package."""

import base64
import json
import os
import queue
import shutil
import subprocess
import threading
import time

BINARY = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
_FLAGS = (
    "--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader",
    "--disable-background-networking", "--no-first-run", "--remote-debugging-pipe",
)  # fmt: skip

_GONE = "Inspected target navigated or closed"


class PageLeftError(RuntimeError):
    """The page went away while it was asked something."""


class Chromium:
    """One browser with one page.

    Attributes
    ----------
    complaints : texts of console errors and warnings, failed requests and uncaught exceptions.
    requests : addresses that pages have asked for.
    """

    def __init__(self, profile, width=1280, height=720):
        self.complaints, self.requests = [], []
        self._id, self._session, self._received = 0, None, queue.Queue()
        read_command, self._write = os.pipe()
        self._read, write_answer = os.pipe()

        def connect():
            command, answer = os.dup(read_command), os.dup(write_answer)
            os.dup2(command, 3)
            os.dup2(answer, 4)

        self._process = subprocess.Popen(
            [BINARY, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
            preexec_fn=connect,  # noqa: PLW1509  # it only copies two descriptors
            pass_fds=(3, 4),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(read_command)
        os.close(write_answer)
        threading.Thread(target=self._listen, daemon=True).start()
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.call(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.set_theme(dark=False)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()
        os.close(self._write)

    def call(self, method, /, **parameters):
        """Result of one command of the protocol."""
        self._id += 1
        message = {"id": self._id, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._received.get(timeout=120)
            if answer.get("id") == self._id:
                if answer.get("error", {}).get("message") == _GONE:
                    raise PageLeftError(method)
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._note(answer)

    def set_theme(self, dark):
        """Let pages believe that the reader prefers a dark or a light theme."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="", features=[scheme])

    def open(self, url):
        """Load a page and wait until it has run its scripts."""
        self.call("Page.navigate", url=url)
        self.until("document.readyState === 'complete'")

    def reload(self):
        """Load the page again and wait until the new one has run its scripts."""
        self.run("window.isOld = true")
        self.call("Page.reload")
        self.until("!window.isOld && document.readyState === 'complete'")

    def run(self, script):
        """Value of a JavaScript expression; a promise is awaited."""
        result = self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def until(self, condition, seconds=60):
        """Wait until a JavaScript expression is true; it is not while the page changes."""
        end = time.monotonic() + seconds
        while not self._holds(condition):
            assert time.monotonic() < end, f"never true: {condition}"
            time.sleep(0.05)

    def _holds(self, condition):
        try:
            return self.run(f"Boolean({condition})")
        except PageLeftError:
            return False

    def screenshot(self):
        """What the window shows, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot")["data"])

    def _listen(self):
        """Split what the browser sends into messages."""
        rest = b""
        while chunk := os.read(self._read, 1 << 20):
            *messages, rest = (rest + chunk).split(b"\0")
            for message in messages:
                self._received.put(json.loads(message))
        os.close(self._read)

    def _note(self, event):
        details = event.get("params", {})
        if event["method"] == "Runtime.exceptionThrown":
            self.complaints.append(str(details["exceptionDetails"]))
        elif event["method"] == "Log.entryAdded":
            self.complaints.append(details["entry"]["text"])
        elif event["method"] == "Runtime.consoleAPICalled" and details["type"] != "log":
            self.complaints.append(str(details["args"]))
        elif event["method"] == "Network.requestWillBeSent":
            self.requests.append(details["request"]["url"])
