"""A headless Chromium, spoken to over the pipe of its DevTools protocol."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import signal
import tempfile
import time
from typing import Any

import numpy as np
from driven import Driven
from PIL import Image

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-device-scale-factor=1",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
PATIENCE = 60.0


def find_browser() -> str | None:
    """``SPLATMORPH_TEST_BROWSER``, or a Chromium or Chrome on the path."""
    given = os.environ.get("SPLATMORPH_TEST_BROWSER")
    return given or shutil.which("chromium") or shutil.which("google-chrome")


class Browser(Driven):
    """One page in a browser of its own, cut off from the network unless ``offline`` is False."""

    patience = PATIENCE

    def __init__(self, program: str, width: int, height: int, *, offline: bool = True) -> None:
        self.profile = tempfile.mkdtemp(prefix="splatmorph-browser-")
        self.events: list[dict[str, Any]] = []
        self.requested = 0
        self.unread = b""
        to_browser, self.to = os.pipe()
        self.answers, from_browser = os.pipe()
        quiet = os.open(os.devnull, os.O_RDWR)
        command = [program, *FLAGS, f"--user-data-dir={self.profile}", "about:blank"]
        self.process = os.posix_spawn(
            program,
            command,
            os.environ,
            file_actions=[
                (os.POSIX_SPAWN_DUP2, quiet, 1),
                (os.POSIX_SPAWN_DUP2, quiet, 2),
                (os.POSIX_SPAWN_DUP2, to_browser, 3),
                (os.POSIX_SPAWN_DUP2, from_browser, 4),
            ],
            setpgroup=0,
        )
        for used in (to_browser, from_browser, quiet):
            os.close(used)
        os.set_blocking(self.answers, False)
        self.session: str | None = None
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(target for target in targets if target["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call(
            "Network.emulateNetworkConditions",
            offline=offline,
            latency=0,
            downloadThroughput=0,
            uploadThroughput=0,
        )
        self.resize(width, height)

    def resize(self, width: int, height: int, mobile: bool = False) -> None:
        """Give the page so many CSS pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send one command and return its result."""
        self.requested += 1
        message = {"id": self.requested, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            for answer in self._read():
                if answer.get("id") == self.requested:
                    if "error" in answer:
                        raise RuntimeError(f"{method}: {answer['error']}")
                    return dict(answer["result"])
                self.events.append(answer)
        raise TimeoutError(f"{method} got no answer from the browser")

    def _read(self) -> list[dict[str, Any]]:
        try:
            arrived = os.read(self.answers, 1 << 20)
        except BlockingIOError:
            time.sleep(0.005)
            return []
        *whole, self.unread = (self.unread + arrived).split(b"\0")
        return [json.loads(message) for message in whole]

    def visit(self, address: str) -> None:
        """Go to an address, all that was heard before forgotten."""
        self.call("Page.navigate", url="about:blank")
        self.events.clear()
        self.call("Page.navigate", url=address)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, promises awaited."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def screenshot(self) -> np.ndarray:
        """The page as it is now, (height, width, 3) uint8."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def click(self, x: float, y: float) -> None:
        """Press and release the mouse, in CSS pixels."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def key(self, key: str, code: str = "", held: int = 0) -> None:
        """Press and release a key, ``held`` the bits of those held down meanwhile."""
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=code or key, modifiers=held
            )

    def complaints(self) -> list[str]:
        """Console errors and warnings, exceptions and refused requests since ``open``."""
        self.evaluate("0")
        found = []
        for event in self.events:
            params = event.get("params", {})
            entry = params.get("entry", {})
            if event["method"] == "Runtime.exceptionThrown":
                found.append(json.dumps(params["exceptionDetails"]))
            elif event["method"] == "Runtime.consoleAPICalled" and params["type"] == "error":
                found.append(json.dumps(params["args"]))
            elif (
                event["method"] == "Log.entryAdded"
                and entry["level"] in ("error", "warning")
                # Reading back a software canvas, as a screenshot does, is called slow.
                and "GPU stall due to ReadPixels" not in entry["text"]
            ):
                found.append(entry["text"])
        return found

    def close(self) -> None:
        """End the browser and remove its profile."""
        os.killpg(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        os.close(self.to)
        os.close(self.answers)
        shutil.rmtree(self.profile, ignore_errors=True)
