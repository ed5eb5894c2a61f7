"""The page's token: nobody of the machine but its owner, nor a script without it, is let in."""

import os
import stat

import pytest

from spiral.app.guard import POLICY, Guard
from spiral.app.serve import redirect_file, token_for
from spiral.types.errors import ConfigError
from tests.loops import on_a_loop

TOKEN, PORT = "a-token-of-this-test", 8765
HOST = {"host": f"127.0.0.1:{PORT}"}
PERSON = {"sec-fetch-mode": "navigate", "sec-fetch-site": "none"}


def asked(kind="http", query="", path="/", **headers):
    """What the application behind the guard saw, and what was answered."""
    seen, sent = [], []
    named = {**HOST, **{k.replace("_", "-"): v for k, v in headers.items()}}
    scope = {
        "type": kind, "method": "GET", "path": path, "query_string": query.encode(),
        "headers": [(k.encode(), v.encode()) for k, v in named.items()],
    }  # fmt: skip

    async def behind(scope, receive, send):
        seen.append(scope)
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive():
        return {"type": "websocket.connect"}

    async def send(message):
        sent.append(message)

    on_a_loop(Guard(behind, PORT, TOKEN)(scope, receive, send))
    return seen, sent


ORIGIN = {"origin": f"http://127.0.0.1:{PORT}"}


KINDS = ("http", "websocket")
MARKED = [pytest.param(kind, marks=pytest.mark.hostile(kind)) for kind in KINDS]


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"cookie": f"spiral-9999={TOKEN}"},  # of a page on another port
        {"cookie": f"spiral-{PORT}={TOKEN[:-1]}"},
        {"cookie": f"spiral-{PORT}="},
        {"cookie": f"spiral-{PORT}=\xe9"},
        {"cookie": "=;=\x00;;"},
        {"authorization": f"Basic {TOKEN}"},
        {"authorization": "Bearer "},
        {"authorization": "Bearer guess"},
        {"query": f"token={TOKEN}x"},
        {"query": f"token={TOKEN}&token=other"},
        {"query": "token="},
        {"cookie": f"spiral-{PORT}={TOKEN}", "origin": "http://evil.example"},
        {"cookie": f"spiral-{PORT}={TOKEN}", "host": "evil.example"},  # DNS rebinding
    ],
)
@pytest.mark.parametrize("kind", MARKED)
def test_only_who_knows_the_token_is_let_in(kind, given):
    seen, sent = asked(kind, **{**ORIGIN, **given})
    assert seen == []
    if kind == "http":
        assert sent[0]["status"] == 403
    else:
        assert sent[0]["type"] == "websocket.close"


@pytest.mark.parametrize(
    "given",
    [
        {"cookie": f"spiral-{PORT}={TOKEN}"},
        {"cookie": f"other=1; spiral-{PORT}={TOKEN}"},
        {"authorization": f"Bearer {TOKEN}"},
        {"query": f"token={TOKEN}"},
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_who_knows_the_token_is_let_in(kind, given):
    assert asked(kind, **given, **ORIGIN)[0]


def test_a_refusal_says_where_the_address_was_printed():
    (_, body) = asked()[1]
    assert b"'spiral app' printed in the terminal" in body["body"]
    assert TOKEN.encode() not in body["body"]


def test_a_browser_that_opens_the_address_gets_a_cookie_and_an_address_without_token():
    seen, (start, body) = asked(query=f"a=1&token={TOKEN}", path="/study/x", **PERSON)
    headers = dict(start["headers"])
    assert seen == []
    assert headers[b"set-cookie"].decode() == (
        f"spiral-{PORT}={TOKEN}; Path=/; HttpOnly; SameSite=Strict"
    )
    assert headers[b"cache-control"] == b"no-store"
    assert b"url=/study/x?a=1" in body["body"]
    assert TOKEN.encode() not in body["body"]


@pytest.mark.hostile("http")
@pytest.mark.parametrize("path", ["//evil.example/", '/"><script>alert(1)</script>'])
def test_the_address_that_one_is_sent_on_to_is_of_this_page(path):
    body = asked(query=f"token={TOKEN}", path=path, **PERSON)[1][1]["body"].decode()
    assert "url=//" not in body
    assert "<script" not in body


def test_every_answer_carries_the_policy():
    headers = dict(asked(cookie=f"spiral-{PORT}={TOKEN}")[1][0]["headers"])
    assert headers[b"content-security-policy"] == POLICY.encode()
    rules = dict(rule.split(" ", 1) for rule in POLICY.split("; "))
    assert rules["default-src"] == rules["script-src-attr"] == "'none'"
    for words in rules.values():  # nothing foreign: no host, no scheme of the network, no star
        assert all(w.startswith("'") or w in ("data:", "blob:") for w in words.split())


@pytest.mark.parametrize(
    "weak", ["short", "x" * 15, "has a space in it....", "a&b=c" * 5, "é" * 20]
)
def test_a_token_that_could_be_guessed_is_refused(weak):
    with pytest.raises(ConfigError) as caught:
        token_for(weak)
    assert weak not in str(caught.value)


def test_a_token_is_given_by_option_or_variable_or_is_random(monkeypatch):
    monkeypatch.delenv("SPIRAL_TOKEN", raising=False)
    assert len({token_for(None) for _ in range(20)}) == 20
    monkeypatch.setenv("SPIRAL_TOKEN", "of-the-environment")
    assert token_for(None) == "of-the-environment"
    assert token_for("of-the-command-line") == "of-the-command-line"


def test_the_browser_is_opened_by_a_file_of_its_owner_alone():
    """Its command line, which every user of the machine sees, holds no token."""
    with redirect_file(f"http://127.0.0.1:{PORT}/?token={TOKEN}") as file:
        assert TOKEN in file.read_text()
        assert TOKEN not in file.as_uri()
        folder = os.lstat(file.parent)
        assert stat.S_IMODE(folder.st_mode) == 0o700
    assert not file.parent.exists()
