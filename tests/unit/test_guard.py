"""A page of another origin cannot drive the app; nor can a name that was given our address."""

import pytest

from spiral.app.guard import Guard, refusal_reason
from tests.loops import on_a_loop

HOSTS = frozenset({"127.0.0.1:8765", "localhost:8765"})


def scope(kind="http", method="GET", **headers):
    named = {
        "host": "127.0.0.1:8765",
        "cookie": "spiral-8765=known-to-its-owner",
        **{k.replace("_", "-"): v for k, v in headers.items()},
    }
    raw = [(k.encode(), v.encode()) for k, v in named.items() if v is not None]
    return {"type": kind, "method": method, "headers": raw, "path": "/"}


@pytest.mark.parametrize(
    ("given", "passes"),
    [
        (scope(), True),
        (scope(host="localhost:8765"), True),
        (scope(method="POST", origin="http://127.0.0.1:8765"), True),
        (scope("websocket", origin="http://127.0.0.1:8765"), True),
        (scope(sec_fetch_site="cross-site", sec_fetch_mode="navigate"), True),  # a link followed
        (scope(host="evil.example:8765"), False),  # DNS rebinding
        (scope(host="127.0.0.1:80"), False),
        (scope(host=None), False),
        (scope(host="127.0.0.1:8765.evil.example"), False),
        (scope(origin="http://evil.example"), False),
        (scope(origin="null"), False),  # a sandboxed frame
        (scope(origin="http://127.0.0.1:9999"), False),  # another program of this machine
        (scope(origin="https://127.0.0.1:8765"), False),
        (scope(method="POST", origin="http://localhost:8765"), False),  # not the host it asks
        (scope(sec_fetch_site="cross-site", sec_fetch_mode="no-cors"), False),  # an image's address
        (scope(method="POST", sec_fetch_site="cross-site", sec_fetch_mode="navigate"), False),
        (scope("websocket"), False),
        (scope("websocket", origin="http://evil.example"), False),
        (scope("websocket", host="evil.example:8765", origin="http://evil.example:8765"), False),
    ],
)
def test_only_this_page_on_this_machine_passes(given, passes):
    assert (refusal_reason(given, HOSTS) == "") is passes


def asked(given):
    """What the application behind the guard saw, and what was sent."""
    seen, sent = [], []

    async def behind(scope, receive, send):
        seen.append(scope)
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive():
        return {"type": "websocket.connect"}

    async def send(message):
        sent.append(message)

    on_a_loop(Guard(behind, 8765, "known-to-its-owner")(given, receive, send))
    return seen, sent


def test_a_refused_request_never_reaches_the_application():
    seen, sent = asked(scope(origin="http://evil.example"))
    assert seen == []
    assert sent[0]["status"] == 403
    assert b"evil.example" in sent[1]["body"]


def test_a_refused_websocket_is_closed_before_it_opens():
    seen, sent = asked(scope("websocket", origin="http://evil.example"))
    assert seen == []
    assert sent == [{"type": "websocket.close", "code": 1008, "reason": sent[0]["reason"]}]


def test_no_other_page_may_put_this_one_in_a_frame():
    headers = dict(asked(scope())[1][0]["headers"])
    assert headers[b"x-frame-options"] == b"DENY"
    assert b"frame-ancestors 'none'" in headers[b"content-security-policy"]
