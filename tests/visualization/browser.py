"""Headless Chromium that tests control by the DevTools protocol over a pair of pipes.

As a script, the module takes a picture of a replay: browser.py PAGE TIME FILE, with the time in seconds. Six optional
values are the position of the camera and the point at the centre of its view, in metres. If the time is a range such as
12:16, the script writes an animation in real time, FILE.webp.
"""

import base64
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # the page must work without a network
    "--window-size=640,400",
    "--remote-debugging-pipe",
)
# The browser reads from file descriptor 3 and writes to 4.
_START_PROGRAM = """
import os, sys
there, back = (os.dup(int(each)) for each in sys.argv[1:3])
high = [os.dup2(each, 100 + i) for i, each in enumerate((there, back))]
for number, each in zip((3, 4), high):
    os.dup2(each, number)
os.execvp(sys.argv[3], sys.argv[3:])
"""


class Browser:
    """Context manager that opens a page in a browser.

    Attributes:
        console: messages on the page's console and in its log, received during calls.
    """

    def __init__(self, page: Path, profile: Path, *, fragment: str = "") -> None:
        self.console: list[str] = []
        browser_input, self._browser_input = os.pipe()
        self._browser_output, browser_output = os.pipe()
        command = [CHROMIUM, *_OPTIONS, f"--user-data-dir={profile}", "about:blank"]
        start = [sys.executable, "-c", _START_PROGRAM, str(browser_input), str(browser_output), *command]
        self._process = subprocess.Popen(start, pass_fds=(browser_input, browser_output), stderr=subprocess.DEVNULL)
        os.close(browser_input)
        os.close(browser_output)
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
        os.close(self._browser_input)
        os.close(self._browser_output)

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol, and return its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._browser_input, json.dumps(message).encode() + b"\0")
        while True:
            reply = self._message()
            if reply.get("id") == self._count:
                assert "error" not in reply, reply
                return reply["result"]
            if reply.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                self.console.append(json.dumps(reply["params"]))

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, expression: str, timeout: float = 600.0) -> None:
        """Wait until a JavaScript expression becomes true in the page."""
        deadline = time.monotonic() + timeout
        while not self.value(f"Boolean({expression})"):
            assert time.monotonic() < deadline, f"{expression} is not true after {timeout} s"
            time.sleep(0.05)

    def screenshot(self, file: Path) -> Path:
        """Write a screenshot of the page as a PNG file."""
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return file

    def _message(self) -> Any:
        while b"\0" not in self._rest:
            more = os.read(self._browser_output, 1 << 16)
            assert more, "the browser has ended"
            self._rest += more
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)


# The README shows the picture 500 px wide, so the window is small and its resolution is high.
_SCREENSHOT_SIZE = {"width": 640, "height": 440, "deviceScaleFactor": 1.5, "mobile": False}
_FILM_SIZE = {"width": 640, "height": 440, "deviceScaleFactor": 1.0, "mobile": False}
# Position of the camera, and the point at the centre of its view, m.
_VIEW = (4.1, -1.5, 3.0, 0.0, -1.15, 0.9)
_FRAME_RATE = 10  # 1/s, frame rate of an animation
_FILM_QUALITY = 55  # quality of the WebP file, from 0 to 100


@contextmanager
def replay(page: Path, moment: float, view: Sequence[float], size: dict[str, Any]) -> Iterator[Browser]:
    """Yield a browser that shows a replay at a time (s).

    `view` is the camera position and the viewed point, (6,), m.
    """
    # In Meshcat's camera frame, Y points up.
    (a, b, c), (d, e, f) = ((x, z, -y) for x, y, z in (view[:3], view[3:]))
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        Browser(page.resolve(), Path(profile), fragment=f"#t={moment}") as browser,
    ):
        browser.wait_for(f"document.getElementById('clock')?.textContent === '{moment:.1f} s'", timeout=60.0)
        browser.call("Emulation.setDeviceMetricsOverride", **size)
        browser.wait_for(f"viewer.renderer.domElement.clientWidth === {size['width']}", timeout=60.0)
        time.sleep(1.0)  # wait until the page has set its own view
        browser.value(f"viewer.camera.position.set({a}, {b}, {c}); viewer.controls.target.set({d}, {e}, {f})")
        browser.value("viewer.controls.update(); viewer.set_dirty()")
        time.sleep(1.0)  # wait for a few frames
        yield browser


def take_picture(page: Path, moment: float, file: Path, view: Sequence[float] = _VIEW) -> None:
    """Write a picture of a replay at a time (s) as PNG, with the view of `replay`."""
    with replay(page, moment, view, _SCREENSHOT_SIZE) as browser:
        browser.screenshot(file)


def take_film(page: Path, first: float, last: float, file: Path, view: Sequence[float] = _VIEW) -> None:
    """Write an animation of a replay from one time to another (s), with the view of `replay`."""
    frames = []
    with replay(page, first, view, _FILM_SIZE) as browser:
        for i in range(round(_FRAME_RATE * (last - first))):
            moment = first + i / _FRAME_RATE
            browser.value(f"document.getElementById('scrub').value = {moment}")
            browser.value("document.getElementById('scrub').oninput()")
            browser.wait_for(f"document.getElementById('clock').textContent === '{moment:.1f} s'", timeout=60.0)
            time.sleep(0.2)  # wait for a few frames
            data = browser.call("Page.captureScreenshot", format="png")["data"]
            frames.append(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
    options = {"duration": 1000 // _FRAME_RATE, "loop": 0, "quality": _FILM_QUALITY, "method": 6}
    frames[0].save(file, save_all=True, append_images=frames[1:], **options)


if __name__ == "__main__":
    moments = [float(each) for each in sys.argv[2].split(":")]
    camera_view = [float(each) for each in sys.argv[4:]] or _VIEW
    write_recording = take_picture if len(moments) == 1 else take_film
    write_recording(Path(sys.argv[1]), *moments, Path(sys.argv[3]), camera_view)
