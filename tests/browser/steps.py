"""What a person does and reads on the page."""

import re
import time

FIRST, SECOND = "cross stiffness", "cubic stiffness"


def error(page):
    """The free-run error shown, in percent: now, and before anything was added."""
    return [float(x) for x in re.findall(r"([\d.]+)\s*%", page.inner_text("#error-now"))]


def shows(page, wanted):
    """Wait until the page shows these errors."""
    until = time.monotonic() + 60
    while (found := error(page)) != wanted and time.monotonic() < until:
        page.wait_for_timeout(100)
    assert found == wanted


def add(page, effect):
    """Click Add."""
    page.click(f"button[aria-label='Add {effect}']:enabled")


def ready(page, effect):
    """Wait until an effect can be added."""
    page.wait_for_selector(f"button[aria-label='Add {effect}']:enabled")


def choose(page, label, option):
    """Choose a column for a series in the mapping."""
    page.click(f"[data-for='{label}'] .q-select")
    page.click(f".q-menu .q-item:has-text('{option}')")
    page.wait_for_selector(f"[data-for='{label}'] .q-select:has-text('{option}')")
