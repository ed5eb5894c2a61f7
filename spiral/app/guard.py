"""Who may talk to the page: a browser on this machine, from the page itself.

A page of another site can make the browser send requests to 127.0.0.1, and can give its own name
the address 127.0.0.1 (DNS rebinding). Both show in the headers: ``Host`` names whom the browser
believes to talk to, ``Origin`` which page asks. Requests and websockets with others are refused.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any
from urllib.parse import urlsplit

Scope = Mapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Any, Any, Any], Awaitable[None]]

NAMES = ("127.0.0.1", "localhost", "[::1]")
_HEADERS = (
    (b"x-frame-options", b"DENY"),
    (b"content-security-policy", b"frame-ancestors 'none'"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"same-origin"),
    (b"x-content-type-options", b"nosniff"),
)


class Guard:
    """An application that refuses strangers before the page's own sees them."""

    def __init__(self, app: App, port: int) -> None:
        self._app = app
        self._hosts = frozenset(f"{name}:{port}" for name in NAMES)

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with a message."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        reason = refusal(scope, self._hosts)
        if not reason:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
        else:
            await _forbid(send, reason)


def refusal(scope: Scope, hosts: Iterable[str]) -> str:
    """Why a request is refused; nothing where it is not.

    A websocket must name its page; a plain request need not (a browser leaves it out of what it
    fetches from the same page), but one that says it comes from elsewhere is refused.
    """
    headers = {k.decode("latin-1").lower(): v.decode("latin-1") for k, v in scope["headers"]}
    host = headers.get("host", "")
    if host not in hosts:
        return f"host {host[:80]!r} is not this machine's page"
    origin = headers.get("origin")
    if origin is None:
        if scope["type"] == "websocket":
            return "a websocket without the page that opened it"
        crossing = headers.get("sec-fetch-site") in ("cross-site", "same-site")
        opened = headers.get("sec-fetch-mode") == "navigate" and scope["method"] == "GET"
        return "asked for by another page" if crossing and not opened else ""
    if origin != f"http://{host}" or urlsplit(origin).netloc not in hosts:
        return f"asked for by another page ({origin[:80]})"
    return ""


def _with_headers(send: Send) -> Send:
    async def sending(message: Any) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *_HEADERS]}
        await send(message)

    return sending


async def _forbid(send: Send, reason: str) -> None:
    text = f"refused: {reason}\n".encode()
    kind = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": 403, "headers": kind})
    await send({"type": "http.response.body", "body": text})
