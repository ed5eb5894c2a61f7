"""What a person does and reads on the page."""

import re
import time
from contextlib import contextmanager, suppress

import psutil
import pytest

from experiments.journeys import screen
from experiments.journeys.screen import error

FIRST, SECOND = "cross stiffness", "cubic stiffness"


def shows(page, wanted):
    """Wait until the page shows these errors."""
    until = time.monotonic() + 60
    while (found := error(page)) != wanted and time.monotonic() < until:
        page.wait_for_timeout(100)
    assert found == wanted


def faults(page, part=None, **options):
    """What axe-core has against the page as it is, or against a part of it."""
    pytest.importorskip("axe_playwright_python.sync_playwright")
    return screen.faults(page, part, **options)


def add(page, effect):
    """Click Add."""
    page.click(f"button[aria-label='Add {effect}']:enabled")


def ready(page, effect):
    """Wait until an effect can be added."""
    page.wait_for_selector(f"button[aria-label='Add {effect}']:enabled")


def filled(page):
    """Names of all Add buttons that are the primary one."""
    wanted = "button[aria-label^='Add ']:not(.q-btn--outline)"
    return page.eval_on_selector_all(wanted, "all => all.map(b => b.getAttribute('aria-label'))")


def judged(page, where):
    """Horizon -> word, of a table or a list of trials."""
    text = page.inner_text(where)
    return re.findall(r"(better|same|worse)", text)


def legend(page, figure):
    """Names in the legend of a figure."""
    wanted = f"#plot-{figure} .legendtext"
    return page.eval_on_selector_all(wanted, "all => all.map(e => e.textContent)")


def choose(page, label, option):
    """Choose a column for a series in the mapping; each list has closed before the next click."""
    page.wait_for_selector(".q-menu", state="detached")
    page.click(f"[data-for='{label}'] .q-select")
    page.click(f".q-menu .q-item:has-text('{option}')")
    page.wait_for_selector(".q-menu", state="detached")
    page.wait_for_selector(f"[data-for='{label}'] .q-select:has-text('{option}')")


def workers(served):
    """The processes beside the page: started by it, told how by ``multiprocessing``'s spawn."""
    children = psutil.Process(served.process.pid).children()
    return [c for c in children if any("spawn_main" in word for word in c.cmdline())]


@contextmanager
def held(served):
    """No process beside the page makes a step, so that no fit ends before the next click."""
    stopped = workers(served)
    for worker in stopped:
        worker.suspend()
    try:
        yield stopped
    finally:
        for worker in stopped:
            with suppress(psutil.NoSuchProcess):  # one that was cancelled
                worker.resume()


def upload(tab, served, file, system="oscillator"):
    """Drop a file and choose its system; the columns have been drawn."""
    tab.goto(served.address)
    tab.set_input_files("#drop-file", file)
    tab.wait_for_selector("#plot-columns .main-svg")
    tab.click(".q-select >> nth=0")
    tab.click(f".q-menu .q-item:has-text('{system}')")
