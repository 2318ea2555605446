"""A headless Chromium, spoken to by the DevTools protocol over a pair of pipes.

As a script it takes a picture of a replay: browser.py PAGE MOMENT FILE, with the moment in seconds, and perhaps where
the eye is and where it looks, in six numbers in metres.
"""

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # no network
    "--window-size=640,400",
    "--remote-debugging-pipe",
)
# The browser reads from file descriptor 3 and writes to 4.
_START = """
import os, sys
there, back = (os.dup(int(each)) for each in sys.argv[1:3])
high = [os.dup2(each, 100 + i) for i, each in enumerate((there, back))]
for number, each in zip((3, 4), high):
    os.dup2(each, number)
os.execvp(sys.argv[3], sys.argv[3:])
"""


class Browser:
    """A page in a browser, as a context manager.

    Attributes:
        console: what the page's console and log said, while somebody was listening.
    """

    def __init__(self, page: Path, profile: Path, *, fragment: str = "") -> None:
        self.console: list[str] = []
        there, self._to = os.pipe()
        self._from, back = os.pipe()
        command = [CHROMIUM, *_OPTIONS, f"--user-data-dir={profile}", "about:blank"]
        start = [sys.executable, "-c", _START, str(there), str(back), *command]
        self._process = subprocess.Popen(start, pass_fds=(there, back), stderr=subprocess.DEVNULL)
        os.close(there)
        os.close(back)
        self._rest, self._count, self._session = b"", 0, None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")
        self.call("Page.navigate", url=page.as_uri() + fragment)

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def call(self, method: str, **parameters: Any) -> Any:
        """The result of a method of the protocol."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._message()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]
            if answer.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                self.console.append(json.dumps(answer["params"]))

    def value(self, expression: str) -> Any:
        """The value of an expression of JavaScript."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, expression: str, timeout: float = 600.0) -> None:
        """Waits until an expression is true."""
        deadline = time.monotonic() + timeout
        while not self.value(f"Boolean({expression})"):
            assert time.monotonic() < deadline, f"{expression} is not true after {timeout} s"
            time.sleep(0.05)

    def screenshot(self, file: Path) -> Path:
        """Writes what is seen as PNG."""
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return file

    def _message(self) -> Any:
        while b"\0" not in self._rest:
            more = os.read(self._from, 1 << 16)
            assert more, "the browser has ended"
            self._rest += more
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)


# The picture of the README is shown 500 px wide: a small window, finely drawn. The eye and where it looks, m.
_SIZE = {"width": 640, "height": 440, "deviceScaleFactor": 1.5, "mobile": False}
_VIEW = (4.1, -1.5, 3.0, 0.0, -1.15, 0.9)


def take_picture(page: Path, moment: float, file: Path, view: Sequence[float] = _VIEW) -> None:
    """Writes what a replay shows at a moment (s) as PNG, from an eye to where it looks (6 numbers, m)."""
    # Meshcat's camera has Y up.
    (a, b, c), (d, e, f) = ((x, z, -y) for x, y, z in (view[:3], view[3:]))
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        Browser(page.resolve(), Path(profile), fragment=f"#t={moment}") as browser,
    ):
        browser.wait_for(f"document.getElementById('clock')?.textContent === '{moment:.1f} s'", timeout=60.0)
        browser.call("Emulation.setDeviceMetricsOverride", **_SIZE)
        browser.wait_for(f"viewer.renderer.domElement.clientWidth === {_SIZE['width']}", timeout=60.0)
        time.sleep(1.0)  # until the page has set its own view
        browser.value(f"viewer.camera.position.set({a}, {b}, {c}); viewer.controls.target.set({d}, {e}, {f})")
        browser.value("viewer.controls.update(); viewer.set_dirty()")
        time.sleep(1.0)  # a few frames
        browser.screenshot(file)


if __name__ == "__main__":
    take_picture(
        Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]), [float(each) for each in sys.argv[4:]] or _VIEW
    )
