"""No web page but its own reads a live viewer, by no name but the machine's."""

from __future__ import annotations

import importlib.util
import re
import socket
from collections.abc import Iterator

import pytest
from test_page import subject

from splatmorph.errors import OptionError
from splatmorph.view import live
from splatmorph.view.scene import Scene
from splatmorph.view.visitors import refusal

LOOPBACK, EVERYWHERE = "127.0.0.1", "0.0.0.0"


@pytest.mark.parametrize("name", ["127.0.0.1:8080", "localhost:9000", "LOCALHOST", "[::1]:8080"])
def test_the_machine_may_be_named_as_it_is(name: str) -> None:
    for listens in (LOOPBACK, EVERYWHERE, "192.168.1.5", "::"):
        assert refusal(listens, [name], []) is None
        assert refusal(listens, [name], [f"http://{name}"]) is None


@pytest.mark.parametrize(
    ("listens", "name", "answered"),
    [
        (LOOPBACK, "192.168.1.5:8080", False),
        ("192.168.1.5", "192.168.1.5:8080", True),
        ("192.168.1.5", "192.168.1.6:8080", False),
        (EVERYWHERE, "192.168.1.5:8080", True),
        (EVERYWHERE, f"{socket.gethostname()}:8080", True),
        (EVERYWHERE, "rebound.example:8080", False),
        ("box.lan", "Box.LAN:8080", True),
        ("box.lan", "rebound.example:8080", False),
    ],
)
def test_names_of_elsewhere_depend_on_where_it_listens(
    listens: str, name: str, answered: bool
) -> None:
    assert (refusal(listens, [name], [f"http://{name}"]) is None) == answered


@pytest.mark.parametrize(
    "hosts",
    [
        [],
        [""],
        ["localhost", "localhost"],
        ["rebound.example"],
        ["127.0.0.1.rebound.example"],
        ["localhost.rebound.example:8080"],
        ["rebound.example#@localhost"],
        ["[::1"],
        ["["],
        ["2130706433"],
        ["127.0.0.1 rebound.example"],
    ],
)
def test_other_hosts_are_refused(hosts: list[str]) -> None:
    assert refusal(LOOPBACK, hosts, [])
    assert refusal(LOOPBACK, hosts, [f"http://{host}" for host in hosts] or ["http://"])


@pytest.mark.parametrize(
    "origin",
    [
        "https://page.example",
        "http://localhost:3000",
        "http://127.0.0.1",
        "http://127.0.0.1:80801",
        "http://127.0.0.1:8080.page.example",
        "null",
        "",
        "file://",
        "http://localhost:8080",
    ],
)
def test_other_pages_are_refused(origin: str) -> None:
    assert refusal(LOOPBACK, ["127.0.0.1:8080"], [origin])
    assert refusal(LOOPBACK, ["127.0.0.1:8080"], ["http://127.0.0.1:8080", origin])


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """Where one listens."""
    if importlib.util.find_spec("viser") is None:
        pytest.skip("viser is not installed (pip install 'splatmorph[view]')")
    viewer = live.serve(Scene.of(subject(100)), port=18441)
    viewer.step(0.0)
    yield viewer.server.get_port()
    viewer.server.stop()


def ask(port: int, host: str, origin: str | None, *, socketed: bool = True) -> bytes:
    """What a browser's request is answered, byte by byte."""
    import viser

    lines = ["GET / HTTP/1.1", f"Host: {host.format(port=port)}"]
    if origin is not None:
        lines.append(f"Origin: {origin.format(port=port)}")
    if socketed:
        lines += [
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
        ]
    said = b""
    with socket.create_connection((LOOPBACK, port), timeout=10) as asking:
        asking.sendall("\r\n".join([*lines, "", ""]).encode())
        while len(said) < 2000 and (got := asking.recv(4096)):
            said += got
    return said


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}"])
def test_its_own_page_is_given_the_splats(port: int, host: str) -> None:
    said = ask(port, host, f"http://{host}")
    assert said.startswith(b"HTTP/1.1 101 ")
    assert len(said) >= 2000
    assert ask(port, host, None, socketed=False).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:{port}", "https://page.example"),
        ("127.0.0.1:{port}", "null"),
        ("127.0.0.1:{port}", "http://localhost:3000"),
        ("rebound.example:{port}", "http://rebound.example:{port}"),
        ("rebound.example:{port}", None),
    ],
)
def test_others_are_given_a_line(
    port: int, host: str, origin: str | None, capfd: pytest.CaptureFixture[str]
) -> None:
    said = ask(port, host, origin)
    assert re.fullmatch(rb"HTTP/1.1 403 .*\r\n\r\n[^\n]+\n", said, re.DOTALL)
    if host.startswith("rebound"):
        assert ask(port, host, origin, socketed=False).startswith(b"HTTP/1.1 403 ")
    assert capfd.readouterr() == ("", "")


def test_a_viser_that_starts_otherwise_serves_nobody(monkeypatch) -> None:
    server = pytest.importorskip("websockets.asyncio.server")
    viser = pytest.importorskip("viser")
    stopped: list[bool] = []

    class Unguarded:
        def __init__(self, **_: object) -> None: ...

        def stop(self) -> None:
            stopped.append(True)

    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    before = server.serve
    with pytest.raises(OptionError, match="viser"):
        live.serve(Scene.of(subject(20)))
    assert stopped
    assert server.serve is before
