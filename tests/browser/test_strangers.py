"""Another site, open in the same browser, cannot drive the page."""

import http.client
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

ATTACK = """
<script>
const tried = {};
const note = (name, value) => { tried[name] = value; };
(async () => {
  const target = "ADDRESS";
  try { await fetch(target + "/", {mode: "cors"}); note("read", "yes"); }
  catch { note("read", "no"); }
  try { await fetch(target + "/upload", {method: "POST", mode: "no-cors", body: "t,x\\n0,1\\n"}); }
  catch { }
  await new Promise((done) => {
    const socket = new WebSocket(target.replace("http", "ws") +
      "/_nicegui_ws/socket.io/?EIO=4&transport=websocket");
    socket.onopen = () => { note("socket", "open"); done(); };
    socket.onerror = () => { note("socket", "refused"); done(); };
  });
  document.title = JSON.stringify(tried);
})();
</script>
"""


@pytest.fixture
def stranger(served, tmp_path):
    """A page of another origin: another port of this machine counts as one."""
    (tmp_path / "index.html").write_text(ATTACK.replace("ADDRESS", served.address))
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


def uploads(served):
    return set(served.out.glob("studies/uploads/*"))


def test_a_page_of_another_origin_reads_nothing_and_opens_no_socket(chromium, served, stranger):
    before = uploads(served)
    page = served.enter(chromium.new_page())  # by its owner's browser, with the cookie in its jar
    page.goto(stranger)
    page.wait_for_function("document.title.includes('socket')")
    assert page.evaluate("JSON.parse(document.title)") == {"read": "no", "socket": "refused"}
    page.close()
    assert uploads(served) == before


def ask(served, method, path, body=b"", **headers):
    link = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
    link.request(method, path, body, {k.replace("_", "-"): v for k, v in headers.items()})
    answer = link.getresponse()
    return answer.status, answer.read().decode()


def test_a_name_that_was_given_our_address_is_refused(served):
    """DNS rebinding: the browser believes to talk to evil.example."""
    status, text = ask(served, "GET", "/", Host="evil.example:80")
    assert status == 403
    assert "evil.example" in text


def test_a_large_upload_is_refused_before_it_is_sent(served):
    """Two gigabytes announced: the answer comes before the first byte, and nothing is kept."""
    before = uploads(served)
    link = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
    link.putrequest("POST", "/upload")
    link.putheader("Authorization", f"Bearer {served.token}")
    link.putheader("Content-Length", str(2 * 10**9))
    link.putheader("Origin", served.address)
    link.endheaders()
    answer = link.getresponse()
    assert answer.status == 413
    assert "at most 1 GB" in answer.read().decode()
    assert uploads(served) == before
