"""Each kind of screen in light and dark, wide and narrow: pictures, and what axe-core finds."""

from __future__ import annotations

from collections.abc import Callable

from experiments.journeys import made_files, records
from experiments.journeys.person import READY, Person
from experiments.journeys.screen import faults
from experiments.journeys.served import SIZE, Served

NARROW = {"width": 390, "height": 844}


def portrayed(person: Person, name: str, part: object = None) -> None:
    """A screen in light and dark, at 1366 and 390 pixels; a row with what axe-core finds."""
    found = []
    for size, width in ((SIZE, "wide"), (NARROW, "narrow")):
        person.page.set_viewport_size(size)
        person.page.wait_for_timeout(1500)
        for scheme in ("light", "dark"):
            person.page.emulate_media(color_scheme=scheme)
            found += [(width, scheme, *one) for one in faults(person.page, part)]
            person.page.evaluate("scrollTo(0, 0)")
            person.page.wait_for_timeout(300)
            person.picture(f"looks-{name}-{width}-{scheme}")
    scrolls = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    sideways = person.page.evaluate(scrolls)
    person.page.set_viewport_size(SIZE)
    person.page.emulate_media(color_scheme="light")
    person.page.wait_for_timeout(1000)
    told = f"axe-core: {found or 'nothing'}; {sideways} pixels too wide at 390"
    person.note(f"looks of {name}", {}, told)


def looks(person: Person, served: Served) -> None:
    """Every kind of screen in light and dark, at 1366 and 390 pixels, with axe-core."""
    page = person.page
    page.goto(served.address)
    page.locator(".choice").first.wait_for()
    portrayed(person, "start")
    file = made_files.write_rows(served.out / "own.csv", made_files.hardening_rows(3000, 1))
    records.dropped(person, served, file)
    page.locator("#foresight:not(.soft)").wait_for()
    portrayed(person, "file")
    records.dropped(person, served, made_files.lost_readings(served.out))
    page.locator("#advice").wait_for()
    portrayed(person, "file-trouble")
    page.goto(served.address)
    person.click(".choice:has-text('Rotor coastdown')")
    person.watch({"preliminary": "any('#preliminary')"})
    portrayed(person, "preliminary")
    person.watch({"ready": READY}, 400.0)
    portrayed(person, "study")
    person.added("Add", "button[aria-label='Add cross stiffness']:enabled")
    portrayed(person, "step")
    page.locator(".q-tab:has-text('Hidden states')").wait_for()
    opened_all(person)
    portrayed(person, "all-opened")
    panel = {"include": [[".q-tabs"], ["[role=tabpanel]"]]}
    for number, title in enumerate(page.locator(".q-tab").all_inner_texts()):
        person.click(f".q-tab >> nth={number}")
        page.locator("[role=tabpanel] .main-svg, [role=tabpanel] .equation").first.wait_for()
        portrayed(person, f"tab-{title}", panel)
    page.goto(served.address)
    page.locator("#studies").wait_for()
    portrayed(person, "studies")


def opened_all(person: Person) -> None:
    """Open what a study keeps folded."""
    for title in ("Where it helps", "Its force over the missing one", "Write an effect of your own",
                  "Compare steps and branches", "The data, and this as a command"):  # fmt: skip
        if person.page.locator(f"text={title}").count():
            person.click(f"text={title}")
            person.page.wait_for_timeout(700)


JOURNEYS: dict[str, Callable[[Person, Served], None]] = {"looks": looks}
