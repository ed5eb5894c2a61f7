"""The tour: a newcomer clicks one button after the other, down to the noise floor."""

import re
import time
from itertools import pairwise

import pytest

from experiments.journeys.served import PATIENCE
from tests.browser.steps import error, faults

NEXT = "#tour button:has-text('Add '):enabled"


@pytest.mark.slow  # a whole study of the rotor by hand: two minutes
def test_a_newcomer_clicks_through_the_tour(tab, served, picture):
    """One button at a time; it ends where nothing more is missing, with the noise's own error."""
    began = time.monotonic()
    tab.goto(served.address)
    tab.click("button:has-text('Take the tour')")
    tab.wait_for_selector("#tour:has-text('A rotor slows down')")
    clicks, errors = 1, []
    while True:
        tab.wait_for_selector(f"{NEXT}, #tour:has-text('What is left is noise')", timeout=PATIENCE)
        errors.append(error(tab)[0])
        if tab.locator("#tour:has-text('What is left is noise')").count():
            break
        if clicks == 1:
            tab.click("#tour button:has-text('Where does it fail?')")
            tab.wait_for_selector(".q-tab--active:has-text('Where it fails')")
            picture(tab, "tour")
            assert faults(tab) == []
        steps = tab.inner_text("#tour h2")
        tab.click(NEXT)
        tab.wait_for_selector(f"#tour h2:not(:has-text('{steps}'))")
        clicks += 1
    print(f"tour: {time.monotonic() - began:.0f} s, {clicks} clicks, {errors}")
    assert clicks <= 6
    assert all(later < earlier for earlier, later in pairwise(errors))
    said = tab.inner_text("#tour")
    (now,), (noise,) = re.findall(r" to ([\d.]+) %", said), re.findall(r"makes ([\d.]+) %", said)
    assert float(now) < 1.1 * float(noise)
    picture(tab, "tour-end")
