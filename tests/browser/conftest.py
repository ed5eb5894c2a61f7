"""One program and one browser for a whole session.

With SPIRAL_SCREENSHOTS=1 every step is kept as a picture in ``screenshots/``: for a look at the
whole page, a second or two each.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from spiral.view.report.pictures import find_browser as found_browser

PICTURES = Path(__file__).parent / "screenshots"
SIZE = {"width": 1366, "height": 900}
PATIENCE = 120_000  # ms, on a machine that does other things too

HARMLESS = (
    "Failed to load resource",  # a refusal that a test asks for
    "Resize must be passed a displayed plot",  # NiceGUI measures a figure that has just gone
)


class Served:
    """The program as a person starts it."""

    def __init__(self, out):
        self.out = out
        self.start()

    def start(self):
        command = [sys.executable, "-m", "spiral", "app", "--port", "0", "--no-browser"]
        self.process = subprocess.Popen(
            [*command, f"out={self.out}"], stdout=subprocess.PIPE, text=True, cwd=self.out
        )
        line = self.process.stdout.readline()
        assert "http://127.0.0.1:" in line, line
        self.entry = line.split()[2]
        self.address, _, self.token = self.entry.partition("/?token=")
        self.port = int(self.address.rsplit(":", 1)[1])

    def enter(self, page):
        """Give a page the cookie that opening the printed address would."""
        page.context.add_cookies([
            {"name": f"spiral-{self.port}", "value": self.token, "url": self.address,
             "httpOnly": True, "sameSite": "Strict"}
        ])  # fmt: skip
        return page

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    """One browser, which keeps what it has fetched and compiled, as a person's does.

    Nothing in it moves (``prefers-reduced-motion``), so that nothing has to be waited for.
    """
    program = found_browser()
    if program is None:
        pytest.skip("no browser: apt install chromium, or set SPIRAL_BROWSER")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as p:
        flags = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        window = p.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"), executable_path=program, args=flags,
            viewport=SIZE, reduced_motion="reduce",
        )  # fmt: skip
        window.set_default_timeout(PATIENCE)
        yield window
        window.close()


@pytest.fixture(scope="session")
def served(chromium, tmp_path_factory):
    program = Served(tmp_path_factory.mktemp("runs"))
    yield program
    if program.process.poll() is None:
        program.stop()


@pytest.fixture
def tab(chromium, served):
    """The browser's one lasting page, blank and of its usual size; no error in its console."""
    page = served.enter(chromium.pages[0] if chromium.pages else chromium.new_page())
    wrong = []
    heard = {
        "console": lambda m: wrong.append(m.text) if m.type == "error" else None,
        "pageerror": lambda e: wrong.append(str(e)),
    }
    for event, hear in heard.items():
        page.on(event, hear)
    yield page
    page.goto("about:blank")
    page.set_viewport_size(SIZE)
    page.emulate_media(color_scheme="light")
    for event, hear in heard.items():
        page.remove_listener(event, hear)
    assert not [w for w in wrong if not any(known in w for known in HARMLESS)]


@pytest.fixture(scope="session")
def picture():
    """Keep a picture of a page, where pictures are asked for."""
    wanted = bool(os.environ.get("SPIRAL_SCREENSHOTS"))
    if wanted:
        PICTURES.mkdir(exist_ok=True)

    def keep(page, name):
        if not wanted:
            return
        page.evaluate("scrollTo(0, 0)")
        page.wait_for_timeout(400)
        page.screenshot(path=PICTURES / f"{name}.png", full_page=True)

    return keep
