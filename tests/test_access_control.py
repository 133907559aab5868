"""Whom the studio's server answers: hostile requests over real sockets, and what stays bounded under them."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("uvicorn", reason="the extra studio is not installed")

from f3sr.mask_page.loopback_server import RequestRefusedError
from f3sr.studio import access_control, bounded_connections, web_server
from f3sr.studio.access_control import AccessControl, AddressSecrets
from f3sr.studio.peer_user import peer_user
from waiting import soon


@dataclass(eq=False)
class Served:
    """A server whose application only notes what reaches it."""

    secrets: AddressSecrets
    port: int
    seen: list[dict[str, Any]] = field(default_factory=list)

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    def raw(self, request: bytes, *, wait: float = 3.0) -> bytes:
        """What comes back until the connection ends, or ``wait`` [s] are over."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=wait) as opened:
            opened.sendall(request)
            parts = []
            try:
                while part := opened.recv(65536):
                    parts.append(part)
            except (TimeoutError, ConnectionResetError):
                pass
            return b"".join(parts)

    def ask(self, path: str, *, method: str = "GET", body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        """Status and whole answer; headers are replaced by name, and left out where empty."""
        given = {"Host": self.host, "Connection": "close"}
        if method == "POST":
            length = str(len(body or b""))
            given |= {"Origin": f"http://{self.host}", "Content-Type": "application/json", "Content-Length": length}
        given |= {name.replace("_", "-"): value for name, value in headers.items()}
        lines = "".join(f"{name}: {value}\r\n" for name, value in given.items() if value)
        answer = self.raw(f"{method} {path} HTTP/1.1\r\n{lines}\r\n".encode() + (body or b""))
        return (int(answer.split(b" ", 2)[1]) if answer else 0), answer


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    secrets, made = AddressSecrets(password="correct horse"), socket.create_server(("127.0.0.1", 0))
    port, seen = made.getsockname()[1], list[dict[str, Any]]()

    async def app(scope: Any, receive: Any, send: Any) -> None:
        message = await receive() if scope["method"] == "POST" else {"body": b""}
        seen.append({"path": scope["path"], "body": message["body"]})
        if scope["path"] != "/stay":
            return await access_control.plain(send, 200, "here")
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"4")]})
        await send({"type": "http.response.body", "body": b"here"})

    async def login(scope: Any, receive: Any, send: Any) -> None:
        await access_control.plain(send, 200, "who are you")

    control = AccessControl(app, secrets, web_server.names_server("127.0.0.1", port), login=login)
    server = web_server.server_of(control)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [made]}, daemon=True)
    thread.start()
    assert soon(lambda: server.started)
    yield Served(secrets, port, seen)
    server.should_exit = True
    thread.join(10)


def test_the_holder_of_the_word_is_let_in_and_the_application_does_not_see_the_word(served: Served) -> None:
    served.seen.clear()
    status, answer = served.ask(f"/{served.secrets.token}/p/mug?x=1")
    assert status == 200 and [s["path"] for s in served.seen] == ["/p/mug"]
    assert b"frame-ancestors 'self'" in answer and b"nosniff" in answer and b"server:" not in answer.lower()
    status, _ = served.ask(f"/{served.secrets.token}/jobs", method="POST", body=b'{"a":1}')
    assert status == 200 and served.seen[-1] == {"path": "/jobs", "body": b'{"a":1}'}


TOKEN = "<token>"
REFUSED = {
    "no word": ("GET", "/", {}, 200),  # the login page
    "another word": ("GET", "/wrong/", {}, 404),
    "half a word": ("GET", "/<half>/", {}, 404),
    "the word without its slash": ("GET", f"/{TOKEN}", {}, 404),
    "a path around it": ("GET", f"/x/../{TOKEN}/", {}, 404),
    "an encoded slash": ("GET", f"/%2F{TOKEN}/", {}, 404),
    "a word in the query": ("GET", f"/?{TOKEN}/", {}, 200),
    "the word as a login": ("POST", f"/{TOKEN}", {}, 404),
    "another host": ("GET", f"/{TOKEN}/", {"Host": "evil.example"}, 404),
    "another host at the port": ("GET", f"/{TOKEN}/", {"Host": "evil.example:<port>"}, 404),
    "no host": ("GET", f"/{TOKEN}/", {"Host": ""}, 400),
    "another port": ("GET", f"/{TOKEN}/", {"Host": "127.0.0.1:1"}, 404),
    "delete": ("DELETE", f"/{TOKEN}/", {}, 404),
    "put": ("PUT", f"/{TOKEN}/", {}, 404),
    "options, as before a foreign request": ("OPTIONS", f"/{TOKEN}/", {"Origin": "http://evil.example"}, 404),
    "trace": ("TRACE", f"/{TOKEN}/", {}, 404),
    "a foreign origin": ("POST", f"/{TOKEN}/x", {"Origin": "http://evil.example"}, 403),
    "an origin of another port": ("POST", f"/{TOKEN}/x", {"Origin": "http://127.0.0.1:1"}, 403),
    "no origin": ("POST", f"/{TOKEN}/x", {"Origin": ""}, 403),
    "the origin of a sandbox": ("POST", f"/{TOKEN}/x", {"Origin": "null"}, 403),
    "a form": ("POST", f"/{TOKEN}/x", {"Content-Type": "application/x-www-form-urlencoded"}, 415),
    "a form of files": ("POST", f"/{TOKEN}/x", {"Content-Type": "multipart/form-data; boundary=a"}, 415),
    "plain text, which needs no leave": ("POST", f"/{TOKEN}/x", {"Content-Type": "text/plain"}, 415),
    "no type": ("POST", f"/{TOKEN}/x", {"Content-Type": ""}, 415),
    "no length": ("POST", f"/{TOKEN}/x", {"Content-Length": ""}, 411),
    "a length in chunks": ("POST", f"/{TOKEN}/x", {"Content-Length": "", "Transfer-Encoding": "chunked"}, 411),
    "too much JSON": ("POST", f"/{TOKEN}/x", {"Content-Length": "2000001"}, 413),
    "too large a photo": (
        "POST",
        f"/{TOKEN}/x",
        {"Content-Type": "application/octet-stream", "Content-Length": "64000001"},
        413,
    ),
    "the framed word for a page": ("GET", "/<framed>/p/mug", {}, 404),
    "the framed word for a change": ("POST", "/<framed>/framed/mug", {}, 404),
    "the word for files of packages": (
        "GET",
        f"/{TOKEN}/framed/mug/package/x.html",
        {},
        404,
    ),
    "a scheme that a header tells": (
        "POST",
        f"/{TOKEN}/x",
        {"X-Forwarded-Proto": "https", "X-Forwarded-For": "10.0.0.1", "Origin": "https://127.0.0.1:<port>"},
        403,
    ),
    "a long password": ("POST", "/login", {"Content-Length": "1001"}, 413),
    "a photo for a password": ("POST", "/login", {"Content-Type": "application/octet-stream"}, 415),
    "the framed word around": ("GET", "/<framed>/x/framed/mug", {}, 404),
}


@pytest.mark.parametrize("name", REFUSED)
def test_who_lacks_the_word_or_is_no_page_gets_one_line(served: Served, name: str) -> None:
    method, path, headers, wanted = REFUSED[name]
    token = served.secrets.token
    words = {TOKEN: token, "<half>": token[:20], "<framed>": served.secrets.framed, "<port>": str(served.port)}
    for word, value in words.items():
        path = path.replace(word, value)
        headers = {k: v.replace(word, value) for k, v in headers.items()}
    served.seen.clear()
    status, answer = served.ask(path, method=method, **headers)
    assert status == wanted and not served.seen
    body = answer.partition(b"\r\n\r\n")[2]
    assert body.count(b"\n") <= 1 and token.encode() not in answer and b"Traceback" not in answer


def test_the_framed_word_shows_files_of_packages_alone(served: Served) -> None:
    served.seen.clear()
    status, _ = served.ask(f"/{served.secrets.framed}/framed/mug/package/report.html")
    assert status == 200 and served.seen[0]["path"] == "/framed/mug/package/report.html"


def test_the_word_that_counts_once_counts_once() -> None:
    secrets = AddressSecrets()
    once = secrets.once
    assert not secrets.takes_once("") and secrets.takes_once(once)
    assert not secrets.takes_once(once) and not secrets.takes_once("") and not secrets.opens(once)


@pytest.mark.parametrize(("user", "status"), [(4242, 404), (os.geteuid(), 303), (0, 303), (None, 303)])
def test_the_word_that_counts_once_is_its_owners(user: int | None, status: int) -> None:
    """Everybody sees the browser's command line, and may be faster than it."""
    secrets, told, answers = AddressSecrets(), list[str](), list[dict[str, Any]]()

    async def send(message: Any) -> None:
        answers.append(message)

    async def inner(scope: Any, receive: Any, send: Any) -> None:
        raise AssertionError("nobody is let in")

    control = AccessControl(inner, secrets, lambda host: True, refused=told.append, user=lambda scope: user)
    scope = {"type": "http", "method": "GET", "path": f"/{secrets.once}/", "headers": [(b"host", b"127.0.0.1")]}
    asyncio.run(control(scope, None, send))  # type: ignore[arg-type]
    assert answers[0]["status"] == status and bool(told) == (status == 404) == bool(secrets.once)
    assert (secrets.token.encode() in str(answers).encode()) == (status == 303)


def test_the_system_tells_whose_a_connection_is() -> None:
    if not Path("/proc/net/tcp").exists():
        pytest.skip("this system has no table of sockets")
    for host, family in (("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6)):
        made = socket.create_server((host, 0), family=family)
        with made, socket.create_connection(made.getsockname()[:2]) as client:
            scope = {"client": client.getsockname()[:2], "server": made.getsockname()[:2]}
            assert peer_user(scope) == os.geteuid()
            if os.geteuid() == 0:
                os.fchown(client.fileno(), 4242, -1)
                assert peer_user(scope) == 4242
    assert peer_user({"client": ("10.0.0.1", 1), "server": ("127.0.0.1", 2)}) is None and peer_user({}) is None


def test_a_password_opens_an_address_of_its_own_and_wrong_ones_are_few(monkeypatch: pytest.MonkeyPatch) -> None:
    secrets = AddressSecrets(password="correct horse")
    word = secrets.entered("correct horse")
    assert word and secrets.opens(word) and word != secrets.token
    for k in range(access_control.MOST_LOGINS):
        assert secrets.entered(f"guess {k}") is None
    with pytest.raises(RequestRefusedError, match="too many"):
        secrets.entered("correct horse")
    assert secrets.opens(word)
    monkeypatch.setattr(access_control, "LOGIN_S", 0.0)
    assert secrets.entered("correct horse")
    assert AddressSecrets().entered("") is None


def test_a_slow_body_ends_after_its_time(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access_control, "BODY_S", 0.3)
    head = (
        f"POST /{served.secrets.token}/x HTTP/1.1\r\nHost: {served.host}\r\nOrigin: http://{served.host}\r\n"
        "Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{"
    )
    start = time.monotonic()
    assert served.raw(head.encode()).startswith(b"HTTP/1.1 408")
    assert time.monotonic() - start < 2


def test_a_head_that_never_ends_is_cut_off_and_so_is_one_that_trickles(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bounded_connections, "HEAD_S", 0.3)
    for before in (b"", b"GET / HTTP/1.1\r\nHost: a\r\nX: "):
        start = time.monotonic()
        assert served.raw(before) == b"" and time.monotonic() - start < 2
    with socket.create_connection(("127.0.0.1", served.port), timeout=3) as opened:
        opened.sendall(f"GET /{served.secrets.token}/ HTTP/1.1\r\nHost: {served.host}\r\n\r\n".encode())
        answer = b""
        while b"here" not in answer:
            answer += opened.recv(65536)
        start = time.monotonic()
        with pytest.raises(OSError):  # a second head, a byte at a time
            while time.monotonic() - start < 2:
                opened.sendall(b"G")
                time.sleep(0.05)
        assert time.monotonic() - start < 2
    head = f"GET /{served.secrets.token}/ HTTP/1.1\r\nHost: {served.host}\r\nX: {'x' * 1_000_000}\r\n\r\n"
    assert b"200 OK" not in served.raw(head.encode())


def test_a_flood_of_connections_is_bounded_and_the_next_page_is_served(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bounded_connections, "MAX_CONNECTIONS", 5)
    opened = [socket.create_connection(("127.0.0.1", served.port), timeout=3) for _ in range(20)]
    try:
        refused = 0
        for one in opened:
            one.settimeout(0.2)
            try:
                refused += one.recv(1) == b""
            except TimeoutError:
                pass
            except ConnectionResetError:
                refused += 1
        assert refused == 15
    finally:
        for one in opened:
            one.close()
    assert soon(lambda: served.ask(f"/{served.secrets.token}/")[0] == 200)


def test_strangers_do_not_keep_the_user_out(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half-open connections take all places again and again while the user works."""
    monkeypatch.setattr(bounded_connections, "MAX_CONNECTIONS", 5)
    request = f"GET /{served.secrets.token}/stay HTTP/1.1\r\nHost: {served.host}\r\n\r\n".encode()
    strangers = list[socket.socket]()
    with socket.create_connection(("127.0.0.1", served.port), timeout=3) as user:
        try:
            for _ in range(4):
                user.sendall(request)
                answer = b""
                while not answer.endswith(b"here"):
                    answer += (part := user.recv(65536))
                    assert part
                for _ in range(8):
                    strangers.append(socket.create_connection(("127.0.0.1", served.port), timeout=3))
                    with suppress(OSError):  # closed already
                        strangers[-1].sendall(b"GET / HTTP/1.1\r\nX: ")
                assert served.ask(f"/{served.secrets.token}/")[0] == 200
        finally:
            for one in strangers:
                one.close()


def test_noise_of_strangers_does_not_fill_the_terminal(served: Served, caplog: pytest.LogCaptureFixture) -> None:
    twice = b"GET / HTTP/1.1\r\nHost: a\r\nHost: b"
    for noise in (b"\x16\x03\x01", b"GET", twice, b"\0" * 100):
        assert b" 200 " not in served.raw(noise + b"\r\n\r\n", wait=0.5)
    assert served.ask("/wrong/", Connection="Upgrade", Upgrade="websocket")[0] == 404
    assert not caplog.records


def test_a_web_socket_is_no_way_in(served: Served) -> None:
    served.seen.clear()
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Key": "x", "Sec_WebSocket_Version": "13"}
    status, answer = served.ask("/wrong/", **upgrade)
    assert status == 404 and not served.seen and b"101" not in answer


def test_a_host_is_this_machine() -> None:
    loopback = web_server.names_server("127.0.0.1", 80)
    assert loopback("127.0.0.1:80") and loopback("localhost:80") and not loopback("127.0.0.1:81")
    assert not loopback("127.0.0.1.evil.example:80") and not loopback("") and not loopback(":80")
    wide = web_server.names_server("0.0.0.0", 80)
    assert wide("192.168.1.5:80") and wide("[fe80::1]:80") and wide(f"{socket.gethostname()}:80")
    assert not wide("evil.example:80") and not wide("192.168.1.5.evil.example:80")


@pytest.mark.parametrize(
    ("host", "port", "named", "strange"),
    [
        ("::1", 81, ["[::1]:81", "localhost:81"], ["::1:81", "[::2]:81", "[::1]"]),
        ("0:0:0:0:0:0:0:1", 81, ["[::1]:81"], ["evil.example:81"]),
        ("127.0.0.1", 80, ["127.0.0.1", "localhost", "127.0.0.1:80"], ["evil.example", "", ":80", ":"]),
        ("", 80, ["192.168.1.5", "[fe80::1]", "localhost"], ["evil.example", "evil.example:80", "", ":80"]),
        ("Box.example", 81, ["box.example:81", "BOX.example:81"], ["box.example:80", "ox.example:81"]),
    ],
)
def test_a_host_is_named_as_browsers_write_it(host: str, port: int, named: list[str], strange: list[str]) -> None:
    names = web_server.names_server(host, port)
    assert [h for h in named if not names(h)] == [] and [h for h in strange if names(h)] == []


def test_the_address_that_is_told_is_listened_on(tmp_path: Path) -> None:
    if not socket.has_dualstack_ipv6():
        pytest.skip("this machine has no IPv6")
    for host in ("::", "::1", "0.0.0.0", "127.0.0.1", "localhost"):
        made, _ = web_server.listening(host, None, tmp_path)
        with made:
            told = urlsplit(web_server.address(host, made, ""))
            socket.create_connection((told.hostname, told.port), timeout=3).close()
            assert web_server.names_server(host, made.getsockname()[1])(told.netloc)


@pytest.mark.parametrize(
    "damage",
    [
        *("", "[]", "7", "null", "{}", '{"port": 8000}', "[" * 100_000, '{"port": ' + "9" * 5000 + "}"),
        *('{"port": "8000", "token": "<40>"}', '{"port": 8000, "token": 7}', '{"port": 8000, "token": ["<40>"]}'),
        *('{"port": 70000, "token": "<40>"}', '{"port": 8000, "token": "a/<40>"}', '{"port": 8000, "token": "short"}'),
    ],
)
def test_a_damaged_address_is_another_one(tmp_path: Path, damage: str) -> None:
    file = tmp_path / web_server.ADDRESS
    file.write_text(damage.replace("<40>", "a" * 43))
    file.chmod(0o600)
    made, secrets = web_server.listening("127.0.0.1", None, tmp_path)
    made.close()
    assert len(secrets.token) == 43 and secrets.token not in damage and json.loads(file.read_text())["token"]


def test_an_address_of_somebody_else_is_not_taken(tmp_path: Path) -> None:
    real, file = tmp_path / "real.json", tmp_path / web_server.ADDRESS
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    real.write_text(json.dumps({"port": port, "token": "a" * 43}))
    real.chmod(0o600)
    file.symlink_to(real)
    made, secrets = web_server.listening("127.0.0.1", None, tmp_path)
    made.close()
    assert secrets.token != "a" * 43 and not file.is_symlink() and "a" * 43 in real.read_text()
    if os.geteuid() == 0:
        real.replace(file)
        os.chown(file, 4242, -1)
        made, secrets = web_server.listening("127.0.0.1", None, tmp_path)
        made.close()
        assert secrets.token != "a" * 43


def test_an_address_stays_with_its_port_and_is_the_owners_alone(tmp_path: Any) -> None:
    made, secrets = web_server.listening("127.0.0.1", None, tmp_path)
    port = made.getsockname()[1]
    made.close()
    file = tmp_path / web_server.ADDRESS
    assert file.stat().st_mode & 0o777 == 0o600 and json.loads(file.read_text())["port"] == port
    made, again = web_server.listening("127.0.0.1", None, tmp_path)
    assert made.getsockname()[1] == port and again.token == secrets.token and again.framed != secrets.framed
    other, fresh = web_server.listening("127.0.0.1", None, tmp_path)  # the port is taken
    assert other.getsockname()[1] != port and fresh.token != secrets.token
    made.close()
    other.close()
    file.chmod(0o644)  # somebody may have read it
    made, third = web_server.listening("127.0.0.1", None, tmp_path)
    made.close()
    assert third.token not in (secrets.token, fresh.token)
