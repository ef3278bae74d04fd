"""Who may ask the picker's server, and what."""

from __future__ import annotations

import http.client
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
from pick_cases import ASSETS, STRAIGHT, told

from renderer import orbit
from splatmorph.io import read
from splatmorph.landmarks import Landmarks
from splatmorph.rendering import bounds
from splatmorph.view.pick import Server, open_desk


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("served")
    paths = [shutil.copy(ASSETS / f"{name}.ply", folder) for name in ("ines", "otto")]
    made = Server(open_desk(paths), "splatmorph fit a b")
    thread = threading.Thread(target=made.serve_forever, daemon=True)
    thread.start()
    yield made
    made.shutdown()
    made.server_close()


class TestServer:
    def ask(self, server: Server, method: str, path: str, body: bytes | None = None, **headers):
        line = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
        try:
            names = {key.replace("_", "-"): value for key, value in headers.items()}
            line.request(method, path, body, names)
            answer = line.getresponse()
            return answer.status, answer.read()
        finally:
            line.close()

    def test_it_listens_to_this_machine_alone(self, server):
        assert server.server_address[0] == "127.0.0.1"
        assert server.token in server.address

    @pytest.mark.parametrize("path", ["/", "/state", "/side?s=0", "/morph?leg=0", "/view?s=0"])
    def test_without_the_token_nothing_is_said(self, server, path):
        for key in ("", "k=wrong", "k=", "k=%00"):
            status, body = self.ask(server, "GET", f"{path}{'&' if '?' in path else '?'}{key}")
            assert status == 403
            assert b"token" in body
        good = {"Content_Type": "application/json"}
        assert self.ask(server, "POST", "/save?k=wrong", b"{}", **good)[0] == 403

    def test_strangers_hosts_and_origins_are_refused(self, server):
        key = f"k={server.token}"
        assert self.ask(server, "GET", f"/state?{key}")[0] == 200
        assert self.ask(server, "GET", f"/state?{key}", Host="evil.example")[0] == 403
        assert self.ask(server, "GET", f"/state?{key}", Origin="http://evil.example")[0] == 403
        assert self.ask(server, "GET", f"/state?{key}", Origin="null")[0] == 403
        own = f"http://127.0.0.1:{server.server_port}"
        assert self.ask(server, "GET", f"/state?{key}", Origin=own)[0] == 200

    def test_only_json_by_post_changes_anything(self, server):
        key, good = f"k={server.token}", {"Content_Type": "application/json"}
        assert self.ask(server, "GET", f"/save?{key}")[0] == 404
        assert self.ask(server, "POST", f"/undo?{key}", b"{}")[0] == 415
        assert self.ask(server, "POST", f"/undo?{key}", b"{}", **good)[0] == 200
        assert self.ask(server, "POST", f"/nothing?{key}", b"{}", **good)[0] == 404
        assert self.ask(server, "PUT", f"/undo?{key}", b"{}", **good)[0] == 501

    @pytest.mark.parametrize(
        "body",
        [b"", b"{", b"[]", b"null", b'{"leg": 9}', b'{"leg": "x"}', b"\xff\xfe", b"[" * 9000],
    )
    def test_nonsense_is_one_line_and_no_end(self, server, body):
        key, good = f"k={server.token}", {"Content_Type": "application/json"}
        for action in ("pick", "accept", "mask", "suggest", "rename"):
            status, said = self.ask(server, "POST", f"/{action}?{key}", body, **good)
            assert 400 <= status < 500
            assert b"error" in said
        assert self.ask(server, "GET", f"/state?{key}")[0] == 200

    def test_long_bodies_are_not_read(self, server):
        key, good = f"k={server.token}", {"Content_Type": "application/json"}
        status, _ = self.ask(
            server, "POST", f"/pick?{key}", b"{}", Content_Length=str(1 << 40), **good
        )
        assert status == 413

    def test_cameras_that_are_none_are_refused(self, server):
        key, good = f"k={server.token}", {"Content_Type": "application/json"}
        camera = told(orbit(server.desk.sides[0].bounds, [0.0], width=100, height=100)[0])
        for change in (
            {"focal": 0},
            {"focal": float("nan")},
            {"width": 1e9},
            {"rows": [[1, 0, 0]] * 3},
            {"shift": [1]},
        ):
            asked = {"leg": 0, "side": 0, "row": None, "x": 1, "y": 1}
            asked["cameras"] = [camera | change, camera]
            body = json.dumps(asked).encode()
            assert self.ask(server, "POST", f"/pick?{key}", body, **good)[0] == 400

    def test_no_file_is_served(self, server):
        for path in ("/../pyproject.toml", "/etc/passwd", "/pick.css"):
            assert self.ask(server, "GET", f"{path}?k={server.token}")[0] == 404


@pytest.mark.skipif(sys.platform == "win32", reason="no interrupt can be sent to a child there")
def test_the_command_that_the_terminal_ends_with_makes_the_morph(tmp_path):
    paths = [shutil.copy(ASSETS / f"{name}.ply", tmp_path) for name in ("ines", "otto")]
    truth = [Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in ("ines", "otto")]
    program = [sys.executable, "-m", "splatmorph"]
    picker = subprocess.Popen(
        [*program, "pick", "ines.ply", "otto.ply", "--no-browser"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        address = picker.stdout.readline().split()[-1]
        line = http.client.HTTPConnection(address.split("/")[2], timeout=60)
        ends = [told(orbit(bounds(read(path)), [0.0], width=400, height=400)[0]) for path in paths]

        def post(action: str, **asked: object) -> dict:
            body, kind = json.dumps(asked), {"Content-Type": "application/json"}
            line.request("POST", f"/{action}?{address.split('?')[1]}", body, kind)
            return json.loads(line.getresponse().read())

        for name in STRAIGHT:
            row = None
            for side, marks in enumerate(truth):
                point = marks.points[marks.names.index(name)].tolist()
                asked = {"leg": 0, "side": side, "row": row, "point": point, "cameras": ends}
                row = post("pick", **asked)["selected"]
        assert "wrote" in post("save")["said"]
        line.close()
        picker.send_signal(signal.SIGINT)
        said, warned = picker.communicate(timeout=60)
    finally:
        picker.kill()
    assert picker.returncode == 0
    assert warned == ""
    command = shlex.split(said.splitlines()[-1])
    assert command == ["splatmorph", "fit", "ines.ply", "otto.ply"]
    done = subprocess.run(
        [*program, *command[1:]], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"{len(STRAIGHT)} landmarks" in done.stdout
