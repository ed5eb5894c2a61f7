"""Requests to a running page that would crash it, hang it, or make it read other files.

make test-slow PYTEST=tests/safety/test_requests.py
"""

import json
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

websockets = pytest.importorskip("websockets.sync.client")
TOKEN = "a-token-of-this-test"
SECRET = "root:x:0"  # of /etc/passwd
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
MOST = 2 * 10**9  # bytes that the page may take
pytestmark = pytest.mark.slow


class Page:
    """The page as a person starts it; its port, and what it says when asked."""

    def __init__(self, place):
        command = [sys.executable, "-m", "spiral", "app", "--port", "0", "--no-browser"]
        self.out = place / "runs"
        with (place / "log").open("w") as log:
            self.process = subprocess.Popen(
                [*command, f"out={self.out}"], stdout=subprocess.PIPE, stderr=log, text=True,
                cwd=place, env={**os.environ, "SPIRAL_TOKEN": TOKEN},
            )  # fmt: skip
        self.port = int(re.search(r":(\d+)/", self.process.stdout.readline())[1])
        self.log = place / "log"

    def lines(self, line, *more):
        """The text of a request whose headers name the page and the token."""
        given = [f"Host: 127.0.0.1:{self.port}", f"Authorization: Bearer {TOKEN}", *more]
        return "\r\n".join([line, *given, "", ""]).encode("latin-1")

    def send(self, text, seconds=10.0):
        """Send these bytes; what comes back until it is silent or hangs up."""
        found = b""
        with socket.create_connection(("127.0.0.1", self.port), timeout=seconds) as link:
            try:
                link.sendall(text)
                while part := link.recv(1 << 16):
                    found += part
            except (TimeoutError, ConnectionError):
                pass
        return found.decode("latin-1")

    def answers(self):
        """Whether it still shows its first page, and soon."""
        began = time.monotonic()
        text = self.send(self.lines("GET / HTTP/1.1", "Connection: close"))
        return text.startswith("HTTP/1.1 200") and time.monotonic() - began < 10

    def peak(self):
        """Most memory it has taken, in bytes."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return 1024 * int(re.search(r"VmHWM:\s+(\d+)", status)[1])


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    found = Page(tmp_path_factory.mktemp("page"))
    yield found
    assert found.process.poll() is None
    print(f"the page took {found.peak() / 1e9:.2f} GB at most")
    assert found.peak() < MOST
    found.process.kill()
    found.process.wait()


CLOSE = "Connection: close"
LINES = {
    "study out of its folder": ("GET /study/..%2f..%2fetc%2fpasswd HTTP/1.1", CLOSE),
    "path out of the page": ("GET /../../../../etc/passwd HTTP/1.1", CLOSE),
    "file out of its folder": ("GET /file/..%2f..%2f..%2fetc HTTP/1.1", CLOSE),
    "run out of its folder": ("GET /take/..%2f..%2fetc/0/run.json HTTP/1.1", CLOSE),
    "name out of a run": ("GET /take/20260101-000000-abc/0/..%2f..%2fpasswd HTTP/1.1", CLOSE),
    "static file out of its folder": (
        "GET /_nicegui/auto/static/..%2f..%2f..%2f..%2f..%2fetc%2fpasswd HTTP/1.1", CLOSE),
    "another program's page": ("GET http://evil.example/ HTTP/1.1", CLOSE),
    "a null in the path": ("GET /file/%00 HTTP/1.1", CLOSE),
    "many parameters": ("GET /?" + "a=1&" * 5000 + " HTTP/1.1", CLOSE),
    "a method that is none": ("SPILL / HTTP/1.1", CLOSE),
    "a version that is none": ("GET / HTTP/9.9", CLOSE),
    "a long line": ("GET /" + "a" * 10**6 + " HTTP/1.1", CLOSE),
    "a long header": ("GET / HTTP/1.1", CLOSE, "X: " + "a" * 10**6),
    "many headers": ("GET / HTTP/1.1", CLOSE, *(f"X{i}: 1" for i in range(20_000))),
    "a cookie of backslashes": ("GET / HTTP/1.1", CLOSE, 'Cookie: a="' + "\\" * 50_000 + '"'),
    "two lengths": ("POST /upload HTTP/1.1", CLOSE, "Content-Length: 5", "Content-Length: 50"),
    "length and pieces": (
        "POST /upload HTTP/1.1", CLOSE, "Content-Length: 5", "Transfer-Encoding: chunked"),
    "a length below nothing": ("POST /upload HTTP/1.1", CLOSE, "Content-Length: -5"),
    "a length without end": ("POST /upload HTTP/1.1", CLOSE, "Content-Length: " + "9" * 4000),
}  # fmt: skip


@pytest.mark.hostile("http")
@pytest.mark.parametrize("name", LINES)
def test_a_request_line_reads_no_other_file_and_stops_nothing(page, name):
    found = page.send(page.lines(*LINES[name]))
    assert SECRET not in found
    assert not re.search(r"^HTTP/1.1 5", found)
    assert page.answers()


@pytest.mark.hostile("http")
@pytest.mark.parametrize(
    "text", [b"\x16\x03\x01\x02\x00" + bytes(500), b"\x00" * 10**6, b"GET", b"\r\n" * 10**5],
    ids=["another protocol", "zeros", "half a word", "empty lines"],
)  # fmt: skip
def test_what_is_no_request_stops_nothing(page, text):
    page.send(text, seconds=2.0)
    assert page.answers()


@pytest.mark.hostile("http")
def test_three_hundred_connections_that_say_nothing_stop_nothing(page):
    links = [socket.create_connection(("127.0.0.1", page.port)) for _ in range(300)]
    for link in links:
        link.sendall(b"GET / HTTP/1.1\r\n")
    try:
        assert page.answers()
    finally:
        for link in links:
            link.close()


@pytest.mark.hostile("http")
@pytest.mark.parametrize(
    "name", ["..%2f..%2fevil.csv", "%00", "a" * 5000, "..", "%F0%9F%98%80" * 300, "C%3A%5Cevil.csv"]
)
def test_an_uploaded_file_stays_in_its_folder_whatever_its_name(page, name):
    before = {p for p in page.out.parent.rglob("*") if page.out not in p.parents}
    body = "t,x\r\n0,1\r\n1,2\r\n"
    head = page.lines("POST /upload HTTP/1.1", CLOSE, f"x-file-name: {name}",
                      f"Content-Length: {len(body)}")  # fmt: skip
    found = page.send(head + body.encode())
    assert re.match(r"HTTP/1.1 (200|400)", found)
    assert {p for p in page.out.parent.rglob("*") if page.out not in p.parents} == before
    uploads = page.out / "studies" / "uploads"
    assert all(p.resolve().is_relative_to(uploads.resolve()) for p in uploads.rglob("*"))
    assert page.answers()


NAMESPACE = "40/_nicegui_ws/,"
EVENT = "42/_nicegui_ws/,"
FRAMES = {
    "no packet": ["hello"],
    "numbers alone": ["9" * 10**5],
    "an empty packet": [""],
    "bytes": [bytes(10**5)],
    "brackets without end": [NAMESPACE, EVENT + "[" * 10**5],
    "an event that is none": [NAMESPACE, EVENT + '["__class__", {}]'],
    "arguments of other types": [NAMESPACE, EVENT + '["event", 5, null]'],
    "another page's client": [NAMESPACE, EVENT + json.dumps(
        ["event", {"client_id": "x", "id": 1, "listener_id": "y", "args": []}])],
    "a handshake that is none": [NAMESPACE, EVENT + '["handshake", {"client_id": "../x"}]'],
    "a place that is none": ["40/" + "a" * 10**4 + ","],
    "many packets": [NAMESPACE, *[EVENT + '["log", "x"]'] * 2000],
    "a frame of 20 MB": ["4" + "2" * 20_000_000],
}  # fmt: skip


@pytest.mark.hostile("websocket")
@pytest.mark.parametrize("name", FRAMES)
def test_a_websocket_reads_no_file_and_stops_nothing(page, name):
    headers = {"Authorization": f"Bearer {TOKEN}"}
    found = []
    try:
        with websockets.connect(
            f"ws://127.0.0.1:{page.port}{SOCKET}", origin=f"http://127.0.0.1:{page.port}",
            additional_headers=headers, open_timeout=10, close_timeout=5,
        ) as link:  # fmt: skip
            found.append(link.recv(timeout=20.0))  # it has let us in
            for frame in FRAMES[name]:
                link.send(frame)
            while True:
                found.append(link.recv(timeout=1.0))
    except (TimeoutError, ConnectionError, websockets_errors()):
        pass
    assert found
    assert not any(SECRET in str(part) for part in found)
    assert page.answers()


def websockets_errors():
    from websockets.exceptions import WebSocketException

    return WebSocketException


@pytest.mark.hostile("websocket")
@pytest.mark.parametrize(
    ("headers", "origin"),
    [({}, None), ({"Authorization": f"Bearer {TOKEN}"}, "http://evil.example"),
     ({"Authorization": "Bearer guess"}, None)],
    ids=["no token", "another site", "a wrong token"],
)  # fmt: skip
def test_a_websocket_of_a_stranger_is_refused(page, headers, origin):
    from websockets.exceptions import InvalidStatus

    with (
        pytest.raises(InvalidStatus, match="403"),
        websockets.connect(
            f"ws://127.0.0.1:{page.port}{SOCKET}", additional_headers=headers,
            origin=origin or f"http://127.0.0.1:{page.port}",
        ),
    ):  # fmt: skip
        raise AssertionError
