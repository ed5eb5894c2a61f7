"""Access control of the page: only requests of its own pages that carry its token are served.

A page of another site can make the browser send requests to 127.0.0.1, and can give its own name
the address 127.0.0.1 (DNS rebinding). Both show in the headers: ``Host`` names whom the browser
believes to talk to, ``Origin`` which page asks. Requests and websockets with others are refused.

Other users of the machine can talk to 127.0.0.1 too. They do not know the token: a secret in the
address that the program prints. A browser that opens it is given a cookie and sent on to the
address without it; a script sends ``Authorization: Bearer TOKEN``.
"""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, Iterable, Mapping
from html import escape
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = Mapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Any, Any, Any], Awaitable[None]]

NAMES = ("127.0.0.1", "localhost", "[::1]")
TOKEN = "token"
_PARAMETERS = 50  # of an address
POLICY = "; ".join(
    (
        "default-src 'none'",
        # NiceGUI starts by a script in the page, and Vue compiles its templates there. No script in
        # an attribute runs, as in <img onerror=...>, and none from elsewhere.
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",
        "script-src-attr 'none'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",  # Plotly draws into them
        "font-src 'self' data:",
        "connect-src 'self'",
        "form-action 'none'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
_HEADERS = (
    (b"x-frame-options", b"DENY"),
    (b"content-security-policy", POLICY.encode()),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"same-origin"),
    (b"x-content-type-options", b"nosniff"),
)


class Guard:
    """An ASGI application that refuses requests from other sites or without the token."""

    def __init__(self, app: App, port: int, token: str) -> None:
        self._app, self._token = app, token
        self._hosts = frozenset(f"{name}:{port}" for name in NAMES)
        self._cookie = f"spiral-{port}"  # cookies of all ports of a machine lie in one jar

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with a message."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        reason = refusal_reason(scope, self._hosts)
        named = "" if reason else self._token_source(scope)
        if not reason and not named:
            reason = NO_TOKEN
        if scope["type"] == "websocket" and reason:
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
        elif reason:
            await _send_forbidden(send, reason)
        elif named == "address" and _is_navigation(scope):
            await _send_cookie_page(scope, send, f"{self._cookie}={self._token}")
        else:
            await self._app(_remove_cookies(scope), receive, _add_headers(send))

    def _token_source(self, scope: Scope) -> str:
        """Where a request names the token: ``cookie``, ``header`` or ``address``; else nothing."""
        headers = _headers(scope)
        kind, _, told = headers.get("authorization", "").partition(" ")
        given = {
            "cookie": _parse_cookies(headers.get("cookie", "")).get(self._cookie, ""),
            "header": told if kind.lower() == "bearer" else "",
            "address": _query_parameters(scope).get(TOKEN, ""),
        }
        token = self._token.encode()
        right = [k for k, v in given.items() if hmac.compare_digest(v.encode(), token)]
        return right[0] if right else ""


NO_TOKEN = (
    "this page is its owner's. Open the address with ?token=... that 'spiral app' printed in the "
    "terminal where it was started; a script sends 'Authorization: Bearer TOKEN'"
)


def refusal_reason(scope: Scope, hosts: Iterable[str]) -> str:
    """Why a request is refused; nothing where it is not.

    A websocket must name its page; a plain request need not (a browser leaves it out of what it
    fetches from the same page), but one that says it comes from elsewhere is refused.
    """
    headers = _headers(scope)
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


def _headers(scope: Scope) -> dict[str, str]:
    return {k.decode("latin-1").lower(): v.decode("latin-1") for k, v in scope["headers"]}


def _parse_cookies(header: str) -> dict[str, str]:
    """Cookies as they are sent, without a look into quotes: the token has none.

    Python's own reader takes over a minute for a value of 50 kB of backslashes.
    """
    pairs = (part.partition("=") for part in header.split(";"))
    return {name.strip(): value.strip() for name, _, value in pairs}


def _remove_cookies(scope: Scope) -> Scope:
    """The request for the page itself, which keeps nothing in a cookie; the token ends here."""
    return {**scope, "headers": [h for h in scope["headers"] if h[0].lower() != b"cookie"]}


def _query_parameters(scope: Scope) -> dict[str, str]:
    """The parameters of an address; nothing where there are more than anyone needs."""
    try:
        query = scope.get("query_string", b"").decode("latin-1")
        return dict(parse_qsl(query, max_num_fields=_PARAMETERS))
    except ValueError:
        return {}


def _is_navigation(scope: Scope) -> bool:
    """Whether a person opens an address, rather than a script asking for it."""
    headers = _headers(scope)
    mode = headers.get("sec-fetch-mode") or (
        "text/html" in headers.get("accept", "") and "navigate"
    )
    return scope["type"] == "http" and mode == "navigate"


async def _send_cookie_page(scope: Scope, send: Send, cookie: str) -> None:
    """Give a browser its cookie and send it on to the address without the token.

    By a page, not by a redirect: where another program's page led here, a browser would not send a
    strict cookie along with a redirected request.
    """
    rest = urlencode({k: v for k, v in _query_parameters(scope).items() if k != TOKEN})
    path = "/" + scope["path"].lstrip("/")  # never another host's, as //evil.example
    target = escape(path + (f"?{rest}" if rest else ""))
    text = (
        f'<!doctype html><title>SPIRAL</title><meta http-equiv="refresh" content="0;url={target}">'
        f'<a href="{target}">SPIRAL</a>'
    )
    kind = [
        (b"content-type", b"text/html; charset=utf-8"),
        (b"cache-control", b"no-store"),
        (b"set-cookie", f"{cookie}; Path=/; HttpOnly; SameSite=Strict".encode()),
        *_HEADERS,
    ]
    await send({"type": "http.response.start", "status": 200, "headers": kind})
    await send({"type": "http.response.body", "body": text.encode()})


def _add_headers(send: Send) -> Send:
    async def send_with_headers(message: Any) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *_HEADERS]}
        await send(message)

    return send_with_headers


async def _send_forbidden(send: Send, reason: str) -> None:
    text = f"refused: {reason}\n".encode()
    kind = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": 403, "headers": kind})
    await send({"type": "http.response.body", "body": text})
