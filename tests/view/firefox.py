"""A headless Firefox, spoken to by WebDriver BiDi over a WebSocket of our own."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from driven import Driven
from PIL import Image

PATIENCE = 90.0
PREFERENCES = {
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "toolkit.telemetry.enabled": False,
    "app.update.enabled": False,
    "webgl.force-enabled": True,
    "webgl.disabled": False,
}


def find_firefox() -> str | None:
    """``SPLATMORPH_TEST_FIREFOX``, or a Firefox on the path."""
    given = os.environ.get("SPLATMORPH_TEST_FIREFOX")
    return given or shutil.which("firefox-esr") or shutil.which("firefox")


@contextlib.contextmanager
def virtual_display() -> Iterator[str | None]:
    """An X server in memory while the block runs; None where there is no Xvfb."""
    program = shutil.which("Xvfb")
    if program is None:
        yield None
        return
    read, write = os.pipe()
    server = subprocess.Popen(
        [program, "-displayfd", str(write), "-nolisten", "tcp", "-screen", "0", "1600x1200x24"],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as told:
        number = told.readline().strip()
    try:
        yield f":{number}"
    finally:
        server.terminate()
        server.wait()


class Firefox(Driven):
    """One page in a browser of its own, ``display`` that of an X server: without one, no WebGL."""

    patience = PATIENCE

    def __init__(self, program: str, width: int, height: int, display: str | None = None) -> None:
        self.profile = tempfile.mkdtemp(prefix="splatmorph-firefox-")
        lines = [f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in PREFERENCES.items()]
        Path(self.profile, "user.js").write_text("\n".join(lines), encoding="utf-8")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.process = subprocess.Popen(
            [
                *(program, "--headless", "--no-remote", "--profile", self.profile),
                *("--remote-debugging-port", str(self.port), "about:blank"),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | ({"DISPLAY": display} if display else {}),
        )
        self.requested, self.unread = 0, b""
        self.line = self._connected()
        self.call("session.new", capabilities={})
        self.context = self.call("browsingContext.getTree")["contexts"][0]["context"]
        viewport = {"width": width, "height": height}
        self.call("browsingContext.setViewport", context=self.context, viewport=viewport)

    def _connected(self) -> socket.socket:
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                line = socket.create_connection(("127.0.0.1", self.port), 2)
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.2)
        line.settimeout(PATIENCE)
        key = base64.b64encode(os.urandom(16)).decode()
        line.sendall(
            f"GET /session HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += line.recv(1)
        if b" 101 " not in answer:
            raise RuntimeError(answer.decode(errors="replace"))
        return line

    def _send(self, text: str) -> None:
        data, mask = text.encode(), os.urandom(4)
        head = b"\x81"
        if len(data) < 126:
            head += bytes([0x80 | len(data)])
        elif len(data) < 1 << 16:
            head += b"\xfe" + struct.pack(">H", len(data))
        else:
            head += b"\xff" + struct.pack(">Q", len(data))
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(data))
        self.line.sendall(head + mask + masked)

    def _exactly(self, count: int) -> bytes:
        found = bytearray()
        while len(found) < count:
            some = self.line.recv(count - len(found))
            if not some:
                raise RuntimeError("the browser has gone")
            found += some
        return bytes(found)

    def _receive(self) -> dict[str, Any]:
        text = b""
        while True:
            first, second = self._exactly(2)
            length = second & 127
            if length == 126:
                (length,) = struct.unpack(">H", self._exactly(2))
            elif length == 127:
                (length,) = struct.unpack(">Q", self._exactly(8))
            data = self._exactly(length)
            if first & 15 in (0, 1):
                text += data
                if first & 128:
                    return dict(json.loads(text))

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send one command and return its result."""
        self.requested += 1
        self._send(json.dumps({"id": self.requested, "method": method, "params": params}))
        while True:
            answer = self._receive()
            if answer.get("id") == self.requested:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer}")
                return dict(answer["result"])

    def visit(self, address: str) -> None:
        """Go to an address."""
        self.call("browsingContext.navigate", context=self.context, url=address, wait="complete")

    def evaluate(self, expression: str) -> Any:
        """The JSON value of a JavaScript expression, promises awaited."""
        wrapped = f"(async () => JSON.stringify(await ({expression}) ?? null))()"
        answer = self.call(
            "script.evaluate",
            expression=wrapped,
            target={"context": self.context},
            awaitPromise=True,
        )
        if answer["type"] == "exception":
            raise RuntimeError(json.dumps(answer["exceptionDetails"]["text"]))
        return json.loads(answer["result"]["value"])

    def click(self, x: float, y: float) -> None:
        """Press and release the mouse."""
        steps = [
            {"type": "pointerMove", "x": x, "y": y},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerUp", "button": 0},
        ]
        source = {"type": "pointer", "id": "mouse", "actions": steps}
        self.call("input.performActions", context=self.context, actions=[source])

    def key(self, key: str) -> None:
        """Press and release a key; Enter is ``\\ue007``."""
        steps = [{"type": "keyDown", "value": key}, {"type": "keyUp", "value": key}]
        source = {"type": "key", "id": "keys", "actions": steps}
        self.call("input.performActions", context=self.context, actions=[source])

    def screenshot(self) -> np.ndarray:
        """The page as it is now, (height, width, 3) uint8."""
        data = self.call("browsingContext.captureScreenshot", context=self.context)["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def close(self) -> None:
        """End the browser and remove its profile."""
        self.line.close()
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)
