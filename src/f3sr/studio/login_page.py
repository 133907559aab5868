"""The page that asks for the password of a server that other machines reach."""

from __future__ import annotations

import json
from http import HTTPStatus
from pathlib import Path
from typing import Any

from f3sr.mask_page.loopback_server import RequestRefusedError
from f3sr.studio.access_control import AddressSecrets, App, Receive, Scope, Send, plain
from f3sr.web.document import WEB, document

HERE = Path(__file__).parent


def login_page(secrets: AddressSecrets) -> App:
    """Answers GET with the page, and POST of a password with the address that it opens."""
    styles = (WEB / "page.css", HERE / "pages" / "studio.css")
    page = document(HERE / "templates" / "login.html", {}, styles=styles, scripts=(HERE / "login.js",), served=True)

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] == "GET":
            return await _send(send, HTTPStatus.OK, page, "text/html; charset=utf-8")
        body = (await receive()).get("body", b"")
        try:
            word = secrets.entered(_password(body))
        except RequestRefusedError as refusal:
            return await plain(send, refusal.status, refusal.why)
        if word is None:
            return await plain(send, HTTPStatus.FORBIDDEN, "another password")
        told: dict[str, Any] = {"address": f"/{word}/{secrets.first}"}
        await _send(send, HTTPStatus.OK, json.dumps(told).encode(), "application/json")

    return answer


def _password(body: bytes) -> str:
    try:
        tree = json.loads(body)
    except (ValueError, RecursionError):
        return ""
    return tree["password"] if isinstance(tree, dict) and isinstance(tree.get("password"), str) else ""


async def _send(send: Send, status: HTTPStatus, body: bytes, kind: str) -> None:
    headers = [(b"content-type", kind.encode()), (b"content-length", str(len(body)).encode())]
    if kind.startswith("text/html"):  # the document has a policy of its own
        headers.append((b"content-security-policy", b"frame-ancestors 'none'"))
    await send({"type": "http.response.start", "status": int(status), "headers": headers})
    await send({"type": "http.response.body", "body": body})
