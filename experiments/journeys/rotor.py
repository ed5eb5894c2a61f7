"""Journeys with the embedded rotor: to the noise floor, branches, figures, what is taken away."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable

from experiments.journeys.person import LIST, Person
from experiments.journeys.screen import error
from experiments.journeys.served import Served

FILLED = "button[aria-label^='Add ']:enabled:not(.q-btn--outline)"
CHOICE = ".choice:has-text('Rotor coastdown')"
TAKE = "button:has-text('Take away')"
DRAWN = "[role=tabpanel] .js-plotly-plot, [role=tabpanel] .equation"
NEW = "[role=tabpanel] .js-plotly-plot:not([data-old]) .main-svg, "
NEW += "[role=tabpanel] .equation:not([data-old])"


def to_the_list(person: Person, served: Served, what: str) -> None:
    """From the first page to the first proposal, with one click."""
    person.page.goto(served.address)
    person.clicks = 0
    person.click(CHOICE)
    person.time(what, LIST, "#error-now", limit=400.0, last=("picture", "ready"))
    person.rows[-1].seen = person.verdict()


def rotor(person: Person, served: Served) -> None:
    """The embedded rotor: without compiled kernels, later, a second study, to the noise floor."""
    served.stop()
    served.variables["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(dir=served.out)
    for what in ("no compiled kernel", "a later program"):
        began = time.monotonic()
        served.start()
        served.enter(person.page)
        person.spent = 0.0  # the whole program is new
        person.note(f"{what}: its start", {"address": time.monotonic() - began})
        to_the_list(person, served, what)
        if what != "a later program":
            served.stop()
    to_the_list(person, served, "a second study")
    began = time.monotonic()
    while person.page.locator(FILLED).count() and len(error(person.page)) < 8:
        name = person.page.locator(FILLED).first.get_attribute("aria-label")
        person.added(str(name), FILLED)
    person.note("to the noise floor", {"all": time.monotonic() - began}, person.verdict())


def tour(person: Person, served: Served) -> None:
    """The tour, one button after the other."""
    page = person.page
    page.goto(served.address)
    began = time.monotonic()
    person.click("button:has-text('Take the tour')")
    following = "#tour button:has-text('Add '):enabled"
    errors = []
    while True:
        page.locator(f"{following}, #tour:has-text('What is left is noise')").first.wait_for()
        errors.append(error(page)[0])
        person.note(f"step {len(errors)}", {"since the tour began": time.monotonic() - began},
                    person.text("#tour"))  # fmt: skip
        if page.locator("#tour:has-text('What is left is noise')").count():
            return
        steps = page.inner_text("#tour h2")
        person.click(following)
        page.locator(f"#tour h2:not(:has-text('{steps}'))").first.wait_for()


def branches(person: Person, served: Served) -> None:
    """Another branch, steps side by side, where an effect helps, figures, a plan, exports."""
    page = person.page
    to_the_list(person, served, "the rotor")
    for effect in ("cross stiffness", "cubic stiffness"):
        person.added(f"Add {effect}", f"button[aria-label='Add {effect}']:enabled")
    person.clicks = 0
    person.click("button:has-text('Undo'):enabled")
    person.time("Undo", {"redo": "document.body.innerText.includes('REDO CUBIC') || "
                                 "document.body.innerText.includes('Redo cubic')"})  # fmt: skip
    if not page.locator("button[aria-label='Add rub']").count():
        person.click("button:has-text('more'):enabled >> nth=-1")
    person.added("another branch: rub", "button[aria-label='Add rub']:enabled")
    person.click("text=Compare steps and branches side by side")
    person.time(
        "two branches side by side", {"drawn": "any('#plot-beside .main-svg')"}, "#branches"
    )
    for title, name in (("Where it helps", "why"), ("Its force over the missing one", "force")):
        if page.locator(f"text={title}").count():
            person.click(f"text={title}")
            person.time(title.lower(), {"drawn": f"any('#plot-{name} .main-svg')"})
    page.locator(TAKE).wait_for()
    page.locator(".q-tab:has-text('Hidden states')").wait_for()
    figures(person)
    exports(person)
    plan = page.locator("button:has-text('Which test tells'):enabled")
    if plan.count():
        person.click("button:has-text('Which test tells'):enabled")
        person.time("which test tells apart", {"plan": "any('#plan table')"}, "#plan")


def figures(person: Person) -> None:
    """Each tab of figures, the one in view last."""
    first, *others = enumerate(person.page.locator(".q-tab").all_inner_texts())
    for number, title in (*others, first):
        person.page.evaluate(f"document.querySelectorAll('{DRAWN}')"
                             ".forEach(e => e.setAttribute('data-old', 1))")  # fmt: skip
        person.click(f".q-tab >> nth={number}")
        person.time(f"tab {title}", {"drawn": f"any('{NEW}')"})


def exports(person: Person) -> None:
    """Twelve files taken away, one after the other, and the whole study as ZIP."""
    page = person.page
    person.click(TAKE)
    page.locator(".q-menu .q-item").first.wait_for()
    names = page.locator(".q-menu .q-item").all_inner_texts()
    page.keyboard.press("Escape")
    page.locator(".q-menu").wait_for(state="detached")
    began = time.monotonic()
    for number, name in enumerate(names):
        saved(person, name, TAKE, f".q-menu .q-item >> nth={number}")
    person.note(f"all {len(names)} of them", {"all": time.monotonic() - began})
    menu = "header button[aria-label^='Study ']"
    saved(person, "the whole study", menu, ".q-menu .q-item:has-text('Export the whole study')")


def saved(person: Person, what: str, menu: str, item: str) -> None:
    """One file from a menu, with its size."""
    person.click(menu)
    with person.page.expect_download() as taken:
        person.click(item)
    file = taken.value.path()
    seconds = {"saved": time.monotonic() - person.began}
    person.note(f"export {what}", seconds, f"{file.stat().st_size / 1e6:.3g} MB")


JOURNEYS: dict[str, Callable[[Person, Served], None]] = {
    "rotor": rotor, "tour": tour, "branches": branches,
}  # fmt: skip
