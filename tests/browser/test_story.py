"""The story on the embedded record, as a person does it: where it fails, Add, the error falls."""

import re
import time

import pytest

FIRST, SECOND = "cross stiffness", "cubic stiffness"


def error(page):
    """The free-run error shown, in percent: now, and before anything was added."""
    text = page.inner_text("#error-now").replace("\u00a0", " ")
    return [float(x) for x in re.findall(r"([\d.]+)\s*%", text)]


def add(page, effect):
    page.click(f"button[aria-label='Add {effect}']:enabled")


def ready(page, effect):
    page.wait_for_selector(f"button[aria-label='Add {effect}']:enabled")


@pytest.fixture(scope="module")
def study(served, chromium):
    """The address of a study with one effect added, and how long its steps took."""
    page = chromium.new_page()
    page.set_default_timeout(60_000)
    began = time.monotonic()
    page.goto(served.address)
    page.click(".choice:has-text('Rotor coastdown')")
    ready(page, FIRST)
    before = error(page)
    add(page, FIRST)
    page.wait_for_selector("#error-now small")
    taken = time.monotonic() - began
    ready(page, SECOND)
    address = page.url
    after = error(page)
    page.close()
    return {"address": address, "before": before, "after": after, "taken": taken}


def test_two_clicks_and_less_than_a_minute_to_the_first_step_down(study):
    assert study["taken"] < 60
    assert len(study["before"]) == 1
    now, first = study["after"]
    assert first == study["before"][0]
    assert now < first


def test_a_reload_finds_the_study_where_it_was(tab, study, picture):
    tab.goto(study["address"])
    tab.wait_for_selector("#plot-free_run .main-svg")
    tab.wait_for_selector("#plot-error-falling .main-svg")
    assert error(tab) == study["after"]
    picture(tab, "study")


def test_undo_and_redo_fit_nothing(tab, study):
    tab.goto(study["address"])
    ready(tab, SECOND)
    tab.click("button:has-text('Undo')")
    tab.wait_for_selector(f"button:has-text('Redo {FIRST}')")
    assert error(tab) == study["before"]
    tab.click(f"button:has-text('Redo {FIRST}')")
    tab.wait_for_selector("#error-now small")
    assert error(tab) == study["after"]
