"""Who may look at a live viewer: its own page, asked for by an address that is the machine's.

A browser lets any page open a WebSocket to any address, and says in ``Origin`` (RFC 6455, 10.2)
whose page it is; only the server can refuse. A page whose own name has been made to lead here
(DNS rebinding) is of our origin by that measure, and is told by the name in ``Host``.
"""

from __future__ import annotations

import contextlib
import http
import importlib
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

Check = Callable[[Any, Any], Any]
"""(connection, request) of websockets -> the response to give at once, or None."""


@contextlib.contextmanager
def own_page_only(host: str) -> Iterator[threading.Event]:
    """Servers of websockets that are begun in the block refuse what :func:`refusal` refuses.

    viser has no setting for it, so its library is wrapped while it starts. -> set once a server
    is guarded; where it isn't, whatever was started goes unguarded.
    """
    # By name, since it is there only where viser is.
    server: Any = importlib.import_module("websockets.asyncio.server")
    serve, guards = server.serve, threading.Event()

    def guarded(*args: Any, process_request: Check | None = None, **options: Any) -> Any:
        guards.set()

        def check(connection: Any, request: Any) -> Any:
            headers = request.headers
            reason = refusal(host, headers.get_all("Host"), headers.get_all("Origin"))
            if reason:
                return connection.respond(http.HTTPStatus.FORBIDDEN, reason + "\n")
            return process_request and process_request(connection, request)

        return serve(*args, process_request=check, **options)

    server.serve = guarded
    try:
        yield guards
    finally:
        server.serve = serve


def refusal(listens: str, hosts: list[str], origins: list[str]) -> str | None:
    """Why a request with these headers is refused by a server at ``listens``; None if it isn't.

    ``Host`` has to name the machine as it may be named where the server listens, and ``Origin``,
    which is missing only where no web page asks, has to be that host.
    """
    if len(hosts) != 1 or not _is_ours(listens, _name(hosts[0])):
        return f"this host isn't {listens}: ask by the address that the viewer was started at"
    if any(origin.partition("://")[2].lower() != hosts[0].lower() for origin in origins):
        return "this is another page's request: only the viewer's own is answered"
    return None


def _name(host: str) -> str:
    """The host without its port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_ours(listens: str, name: str) -> bool:
    address, bound = _address(name), _address(listens)
    if name == "localhost" or (address and address.is_loopback):
        return True
    if bound is None:
        return name == listens.lower()
    if not bound.is_unspecified:
        return address == bound
    # At every address: numbers can't be made to lead here, names can, except the machine's.
    return address is not None or name in {socket.gethostname().lower(), socket.getfqdn().lower()}


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None
