"""The studio's web server: its address, its password, and its life."""

from __future__ import annotations

import ipaddress
import json
import os
import re
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from f3sr.errors import F3srError, InputError, OutputError, reason
from f3sr.files import strict_json
from f3sr.mask_page.loopback_server import HOST, TOKEN_BYTES
from f3sr.runtime.atomic_file import write_whole
from f3sr.runtime.extras import library
from f3sr.studio.access_control import AddressSecrets

if TYPE_CHECKING:
    from uvicorn import Server

ADDRESS = "address.json"
"""In the workspace, for its owner alone: a server that is started again has the address that open pages know."""
MAX_ADDRESS = 10_000
"""Bytes of it."""
TOKEN = re.compile(f"[A-Za-z0-9_-]{{{4 * TOKEN_BYTES // 3},100}}")
EVERYWHERE = ("0.0.0.0", "::", "")
PASSWORD = "F3SR_STUDIO_PASSWORD"
"""Environment variable of the password that ``--host`` needs."""
LEAST_PASSWORD = 8
"""Characters of a password."""
HTTP_PORT = 80
"""Which browsers leave out of an address."""
MAX_HEAD = 64_000
"""Bytes of a request before its body."""
GRACE_S = 3
"""How long requests in hand may take when the server ends [s]; jobs go on without it."""


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a host's name or number."""
    if host == "localhost":
        return True
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def require_password(host: str) -> str:
    """The password for a host that other machines reach, from the environment or the terminal; empty for this one.

    Raises InputError for one that is too short, or where none can be asked for.
    """
    if is_loopback(host):
        return ""
    password = os.environ.get(PASSWORD, "")
    if not password and sys.stdin.isatty():
        from getpass import getpass

        password = getpass(f"Password for pages on {host}: ")
    if len(password) < LEAST_PASSWORD:
        found = f"{len(password)} characters" if password else "none"
        raise InputError("the password", found=found, accepted=f"{LEAST_PASSWORD} or more, in {PASSWORD}")
    return password


def listening(host: str, port: int | None, folder: Path) -> tuple[socket.socket, AddressSecrets]:
    """A socket that listens, and the secrets of its address: those of the server before, where its port is free.

    Raises F3srError where the host or the port cannot be had.
    """
    known = _known(folder / ADDRESS) if is_loopback(host) else {}
    made = _bound(host, port if port is not None else known.get("port", 0), or_any=port is None)
    is_same = made.getsockname()[1] == known.get("port")
    token = known["token"] if is_same else secrets.token_urlsafe(TOKEN_BYTES)
    if is_loopback(host):
        _keep(folder / ADDRESS, {"port": made.getsockname()[1], "token": token})
    return made, AddressSecrets(token=token)


def names_server(host: str, port: int) -> Callable[[str], bool]:
    """Whether a Host header names this server. A page elsewhere cannot give its own name to this machine (DNS
    rebinding): names are those of the machine, and numbers have no names. Browsers write them in small letters."""
    of_machine = {HOST} if is_loopback(host) else {socket.gethostname(), socket.getfqdn()}
    names = {name.lower() for name in (_in_address(host), "localhost", *of_machine) if name}

    def named(header: str) -> bool:
        has_port = ":" in header and not header.endswith("]")
        name, _, number = header.lower().rpartition(":") if has_port else (header.lower(), "", str(HTTP_PORT))
        if number != str(port):
            return False
        if name in names:
            return True
        with suppress(ValueError):
            return host in EVERYWHERE and bool(ipaddress.ip_address(name.strip("[]")))
        return False

    return named


def server_of(app: Any) -> Server:
    """A server of the application, not running yet."""
    uvicorn = library("uvicorn", extra="studio", why="the studio")
    from f3sr.studio.bounded_connections import BoundedConnection

    config = uvicorn.Config(
        app,
        http=BoundedConnection,
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="error",  # what strangers send is told once, by access_control
        access_log=False,
        proxy_headers=False,  # a header says neither who asks nor by which scheme
        server_header=False,
        h11_max_incomplete_event_size=MAX_HEAD,
        timeout_graceful_shutdown=GRACE_S,
    )
    return uvicorn.Server(config)


def run(app: Any, made: socket.socket, *, opened: Callable[[], object] = lambda: None) -> None:
    """Serve the application until Ctrl-C or a signal. ``opened`` is called once it answers."""
    server = server_of(app)
    with suppress(KeyboardInterrupt), _told(server, opened):
        server.run(sockets=[made])


def address(host: str, made: socket.socket, path: str) -> str:
    """Of a page."""
    name = HOST if host in EVERYWHERE else _in_address(host)
    return f"http://{name}:{made.getsockname()[1]}/{path}"


def _in_address(host: str) -> str:
    """A host's name or number as addresses and browsers write it."""
    with suppress(ValueError):
        number = ipaddress.ip_address(host)
        return f"[{number.compressed}]" if number.version == 6 else number.compressed
    return host


@contextmanager
def _told(server: Server, opened: Callable[[], object]) -> Generator[None]:
    """Call ``opened`` once the server has started."""
    ended = threading.Event()

    def wait() -> None:
        while not ended.wait(0.02):
            if server.started:
                opened()
                return

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _bound(host: str, port: int, *, or_any: bool) -> socket.socket:
    """A socket that listens on the port, ``or_any`` other one where that is taken."""
    try:
        both = host == "::" and socket.has_dualstack_ipv6()  # the address that is told is a number of version 4
        return socket.create_server((host, port), family=_family(host), backlog=64, dualstack_ipv6=both)
    except OSError as error:
        if or_any and port:
            return _bound(host, 0, or_any=False)
        raise F3srError(f"{host}:{port}: cannot be listened on ({reason(error)})") from error


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def _known(file: Path) -> dict[str, Any]:
    """Port and token of the server before; empty where they are not known, or others could read them."""
    with suppress(OSError, InputError):
        status = file.lstat()
        if status.st_mode & 0o077 == 0 and status.st_uid == os.geteuid() and not file.is_symlink():
            known = strict_json.read(file, most=MAX_ADDRESS)
            port, token = (known.get("port"), known.get("token")) if isinstance(known, dict) else (None, None)
            if type(port) is int and 0 < port < 65536 and isinstance(token, str) and TOKEN.fullmatch(token):
                return {"port": port, "token": token}
    return {}


def _keep(file: Path, value: dict[str, Any]) -> None:
    """For its owner alone; a full disk costs the address, not the server."""
    with suppress(OutputError):
        write_whole(file, json.dumps(value).encode(), mode=0o600)
