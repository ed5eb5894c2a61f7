"""One program and one browser for a whole session.

With SPIRAL_SCREENSHOTS=1 every step is kept as a picture in ``screenshots/``: for a look at the
whole page, a second or two each.
"""

import os
from pathlib import Path

import pytest

from experiments.journeys.served import HARMLESS, SIZE, Served, open_browser
from spiral.view.report.pictures import find_browser as found_browser

PICTURES = Path(__file__).parent / "screenshots"


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    """One browser, which keeps what it has fetched and compiled, as a person's does."""
    program = found_browser()
    if program is None:
        pytest.skip("no browser: apt install chromium, or set SPIRAL_BROWSER")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as p:
        window = open_browser(p, program, tmp_path_factory.mktemp("profile"))
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
