"""The picker's server: this machine only, a token in the address, one page and a few questions.

Nothing here is for others: it listens on 127.0.0.1, names the hosts that it answers to (a name
of a stranger's may be made to point here), takes no page from elsewhere for its own (``Origin``),
writes by POST alone, and reads no long body.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread
from typing import Any
from urllib.parse import parse_qs, urlsplit

from splatmorph.errors import OptionError, SplatmorphError
from splatmorph.view.pick import between
from splatmorph.view.pick.desk import Desk
from splatmorph.view.pick.page import picker_page
from splatmorph.view.pick.sides import PictureSide, SplatSide, camera_from

HOST = "127.0.0.1"
LONGEST_BODY = 1 << 18
TRIES = 50
JSON = "application/json"

Query = Mapping[str, str]


class Server(ThreadingHTTPServer):
    """One session, served until ``shutdown``.

    Raises:
        OptionError: no port from ``port`` on is free.
    """

    daemon_threads = True

    def __init__(self, desk: Desk, command: str, port: int = 0) -> None:
        self.desk, self.lock = desk, Lock()
        self.token = secrets.token_urlsafe(16)
        for number in range(port, port + (TRIES if port else 1)):
            try:
                super().__init__((HOST, number), _Handler)
                break
            except (OSError, OverflowError) as error:
                trouble = error
        else:
            raise OptionError(f"can't listen at {HOST}:{port} ({trouble}): give another `port`")
        self.hosts = {f"{name}:{self.server_port}" for name in (HOST, "localhost")}
        Thread(target=self._warm, daemon=True).start()
        self.page = picker_page(desk.sides, desk.names, command)

    def _warm(self) -> None:
        """What the first click would wait for."""
        for side in self.desk.sides:
            if isinstance(side, SplatSide):
                side.seen_from_outside(side.center + 0.1 * side.radius)

    @property
    def address(self) -> str:
        """Where to point a browser."""
        return f"http://{HOST}:{self.server_port}/?k={self.token}"

    def handle_error(self, *_: Any) -> None:
        """A browser that goes away in the middle of an answer is nothing to report."""


class _Refused(Exception):
    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    timeout = 60
    server_version, sys_version = "splatmorph", ""

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def _answer(self, answer: Any) -> None:
        try:
            path, query = self._allowed()
            self._send(*answer(path, query))
        except _Refused as error:
            self.close_connection = True
            self._send(json.dumps({"error": str(error)}).encode(), JSON, error.status)
        except SplatmorphError as error:
            self._send(json.dumps({"error": str(error)}).encode(), JSON, 400)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            said = f"this makes no sense: {type(error).__name__}"
            self._send(json.dumps({"error": said}).encode(), JSON, 400)

    def _allowed(self) -> tuple[str, Query]:
        """Path and query of a request that comes from our own page."""
        if self.headers.get("Host") not in self.server.hosts:
            raise _Refused(403, "another host")
        origin = self.headers.get("Origin")
        if origin is not None and origin.removeprefix("http://") not in self.server.hosts:
            raise _Refused(403, "another origin")
        url = urlsplit(self.path)
        query = {key: values[-1] for key, values in parse_qs(url.query).items()}
        if not secrets.compare_digest(query.get("k", "").encode(), self.server.token.encode()):
            raise _Refused(403, "the address lacks the token: take the one that the terminal shows")
        return url.path, query

    def _send(self, body: bytes, kind: str = JSON, status: int = 200) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("X-Frame-Options", "DENY")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def _post(self, path: str, _: Query) -> tuple[bytes, str]:
        if self.headers.get("Content-Type") != JSON:
            raise _Refused(415, "expected JSON")
        length = self.headers.get("Content-Length", "")
        if not length.isascii() or not length.isdigit():
            raise _Refused(411, "expected a length")
        if int(length) > LONGEST_BODY:
            raise _Refused(413, f"more than {LONGEST_BODY} bytes")
        asked = json.loads(self.rfile.read(int(length)))
        desk, name = self.server.desk, path.removeprefix("/")
        if not isinstance(asked, dict) or name not in {*desk.actions, *desk.questions}:
            raise _Refused(404, "there is nothing here")
        with self.server.lock:
            answer = desk.answer(name, asked)
        return json.dumps(answer, allow_nan=False).encode(), JSON

    def _get(self, path: str, query: Query) -> tuple[bytes, str]:
        if path == "/":
            return self.server.page, "text/html; charset=utf-8"
        desk = self.server.desk
        if path == "/state":
            with self.server.lock:
                return json.dumps(desk.state(), allow_nan=False).encode(), JSON
        if path in ("/side", "/view"):
            number = int(query["s"])
            if not 0 <= number < len(desk.sides):
                raise _Refused(404, "there is no such input")
            return self._side(desk.sides[number], path, query)
        if path == "/morph":
            return self._morph(query)
        raise _Refused(404, "there is nothing here")

    def _side(self, side: SplatSide | PictureSide, path: str, query: Query) -> tuple[bytes, str]:
        if isinstance(side, PictureSide):
            return side.png, "image/png"
        if path == "/side":
            return json.dumps(side.payload, allow_nan=False).encode(), JSON
        return side.drawn(camera_from(json.loads(query["c"]))), "image/jpeg"

    def _morph(self, query: Query) -> tuple[bytes, str]:
        """The morph of a leg to be played, or where ``t`` is given, a picture of it."""
        desk, leg = self.server.desk, int(query["leg"])
        if not 0 <= leg < len(desk.sides) - 1:
            raise _Refused(404, "there is no such leg")
        with self.server.lock:
            guide = desk.guide(leg)
        if guide.flow is None:
            raise OptionError(guide.trouble or "too few pairs for a morph yet")
        source, target = desk.sides[leg], desk.sides[leg + 1]
        t = min(max(float(query.get("t", "0")), 0.0), 1.0)
        if isinstance(source, PictureSide) and isinstance(target, PictureSide):
            return between.plane(source, target, guide, t), "image/jpeg"
        assert isinstance(source, SplatSide)
        assert isinstance(target, SplatSide)
        if "t" in query:
            camera = camera_from(json.loads(query["c"]))
            return between.still(source, target, guide, t, camera), "image/jpeg"
        made = between.moving(source, target, guide)
        return json.dumps(made, allow_nan=False).encode(), JSON
