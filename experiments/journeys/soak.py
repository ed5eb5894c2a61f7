"""Two tabs on one study for half an hour: memory of server, fits, browser and tabs."""

from __future__ import annotations

import itertools
import os
import re
import time
from typing import Any

import psutil

from experiments.journeys import made_files, records
from experiments.journeys.person import READY, Person, predicate
from experiments.journeys.served import Served

_SEEN = 300  # ms in which a person sees what the last click did, before the next
EVERY = 10  # effects between two rows
_HEAP = "() => Math.round(performance.memory.usedJSHeapSize / 1e5) / 10"
_NODES = "() => document.querySelectorAll('*').length"


def soak(person: Person, served: Served) -> None:
    """Effects added in turn in two tabs, up to three on one another, then undone; memory."""
    file = made_files.write_rows(served.out / "soak.csv", made_files.hardening_rows(3000, 1))
    records.dropped(person, served, file)
    records.compared(person, "compared")
    tabs = [person.page, person.page.context.new_page()]
    tabs[1].goto(tabs[0].url)
    until = time.monotonic() + 60 * float(os.environ.get("SOAK_MINUTES", "30"))
    memory(person, served, tabs, 0)
    for done in itertools.count(1):
        if time.monotonic() > until:
            memory(person, served, tabs, done - 1)
            return
        one_effect(person, tabs[done % 2], tabs[(done + 1) % 2], done)
        if done % EVERY == 0:
            memory(person, served, tabs, done)


def one_effect(person: Person, tab: Any, other: Any, number: int) -> None:
    """Add a candidate in one tab, change its figures; every third time undo all in the other."""
    tab.bring_to_front()
    person.page = tab
    tab.wait_for_function(predicate(READY))
    shown_all(tab)
    choices = tab.locator("button[aria-label^='Add ']:enabled")
    choices.first.wait_for()
    chosen = choices.nth((7 * number) % choices.count())
    new = another_step(tab)
    person.start_clock()
    chosen.click()
    person.watch({"ready": f"{new} && ({READY})"}, 240.0)
    titles = tab.locator(".q-tab").count()
    tab.locator(".q-tab").nth(number % titles).click()
    tab.locator("[role=tabpanel] .main-svg, [role=tabpanel] .equation").first.wait_for()
    if number % 3 == 0:
        undone(other, tab.locator(".chip.added").count())


def shown_all(tab: Any) -> None:
    """Have all candidates listed."""
    more = tab.get_by_role("button", name=re.compile(r"^Show \d+ (more|cand)"), disabled=False)
    more.or_(tab.locator("button[aria-label^='Add ']:enabled")).first.wait_for()
    if more.count():
        more.first.click()
        tab.locator("button:has-text('Show fewer')").first.wait_for()


def another_step(tab: Any) -> str:
    """A condition: the address names another step than now."""
    return f"location.search != {tab.evaluate('location.search')!r}"


def undone(tab: Any, added: int) -> None:
    """Undo until the model is as it was, once the tab shows what was added in the other one."""
    tab.bring_to_front()
    shown = f"document.querySelectorAll('.chip.added').length == {added}"
    tab.wait_for_function(predicate(f"{shown} && ({READY})"))
    while tab.locator(".chip.added").count():
        gone = another_step(tab)
        tab.locator("button:has-text('Undo'):enabled").first.click()
        tab.wait_for_function(predicate(f"{gone} && ({READY})"))
        tab.wait_for_timeout(_SEEN)


def memory(person: Person, served: Served, tabs: list[Any], effects: int) -> None:
    """A row: MB of each process, shared pages divided, and what the two tabs hold."""
    mine = psutil.Process(served.process.pid)
    workers = [p for p in mine.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
    browser = [p for p in psutil.Process().children(recursive=True) if "chrom" in p.name()]
    found = {"server": megabytes([mine])}
    found |= {f"worker {i}": megabytes([p]) for i, p in enumerate(workers, 1)}
    found["browser"] = megabytes(browser)
    for i, tab in enumerate(tabs, 1):
        found |= {f"nodes {i}": tab.evaluate(_NODES), f"heap {i}": tab.evaluate(_HEAP)}
    person.note(f"after {effects} effects (MB, not seconds)", found)


def megabytes(processes: list[psutil.Process]) -> float:
    """Their memory, pages that several share divided among them."""
    total = 0.0
    for process in processes:
        try:
            total += process.memory_full_info().pss
        except psutil.Error:
            continue
    return total / 1e6
