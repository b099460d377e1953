"""HTTP server of the app."""

import errno
import ipaddress
import os
import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import uvicorn

from labbook_web.app import application
from labbook_web.connections import Connection
from labbook_web.guard import Guard
from labbook_web.store import LabStore

PORT = 8321
"""Default port."""
_NICENESS = 10
"""Increment of the niceness of the process: running studies have priority."""


class CannotServe(Exception):
    """Error that keeps the app from being served; the message has the remedy."""


def serve(
    lab: Path,
    studies: Sequence[Path] = (),
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    remote: bool = False,
    read_only: bool = False,
    browse: bool = False,
    say: Callable[[str], None] = print,
) -> None:
    """Serve the pages of a lab until Ctrl-C.

    Args:
        lab: Folder of the lab.
        studies: Study files besides those of the lab.
        host: Address to listen on.
        port: Port; None for PORT, or any free one if that is in use.
        remote: Allow an address that other machines can reach; clients then need a token.
        read_only: Refuse to write notes and tags.
        browse: Open the first page in a browser.
        say: Called with the address.

    Raises:
        CannotServe: An address that needs `remote`, or a port that cannot be used.
    """
    local = is_loopback(host)
    if not local and not remote:
        raise CannotServe(
            f"{host} can be reached by other machines: add --remote to allow it; clients then need a token"
        )
    token = "" if local else secrets.token_urlsafe(24)
    listener = _listen(host, PORT if port is None else port, or_any=port is None)
    port = listener.getsockname()[1]
    name = f"[{host}]" if ":" in host else host
    hosts = frozenset(f"{one}:{port}" for one in (name, "localhost", "127.0.0.1", "[::1]")) if local else frozenset()
    app = application(LabStore(lab, studies), read_only=read_only, hosts=hosts, token=token)
    address = f"http://{name}:{port}/" + (f"?token={token}" if token else "")
    say(f"Serving {lab} at {address} (Ctrl-C ends it)")
    with suppress(OSError):
        os.nice(_NICENESS)
    if browse:
        threading.Timer(0.5, webbrowser.open, [address]).start()
    with suppress(KeyboardInterrupt):
        server(app).run(sockets=[listener])


def server(app: Guard) -> uvicorn.Server:
    """Make the HTTP server of the app."""
    config = uvicorn.Config(
        app, http=Connection, ws="none", log_level="warning", access_log=False, server_header=False,
        proxy_headers=False, timeout_keep_alive=10, h11_max_incomplete_event_size=16_384,
    )  # fmt: skip
    return uvicorn.Server(config)


def is_loopback(host: str) -> bool:
    """True of a loopback address, which only this machine reaches."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _listen(host: str, port: int, or_any: bool) -> socket.socket:
    """Open a listening socket; with `or_any` on any free port if this one is in use."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()  # whoever reads the address may come before the server runs
    except OSError as error:
        listener.close()
        if or_any and error.errno == errno.EADDRINUSE:
            return _listen(host, 0, or_any=False)
        raise CannotServe(f"{host} port {port}: {error.strerror}; choose another one with --port") from error
    return listener
