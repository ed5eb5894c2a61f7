"""A person at the page: each click and letter is counted, and when something came into view."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import psutil
from playwright.sync_api import Error

_LOOKS = ((3.0, 0.02), (30.0, 0.05), (float("inf"), 0.2))
"""Up to so many seconds after a click, the page is looked at every so many seconds."""
HOLDS = {
    "any": "q => !!document.querySelector(q)",
    "seen": "q => [...document.querySelectorAll(q)].some(e => e.offsetParent !== null)",
}
NUMBER = "any('#error-now') && /%|finite/.test(document.querySelector('#error-now').innerText)"
PICTURE = "any('#plot-free_run:not([data-old]) .main-svg')"
PRELIMINARY = "any('#preliminary')"
READY = "(any('#ending') || any('#proposal:not(.soft)')) && !any('.working')"
LIST = {"number": NUMBER, "picture": PICTURE, "preliminary": PRELIMINARY, "ready": READY}


def says(selector: str, text: str) -> str:
    """A condition: an element in view says this."""
    return (
        f"[...document.querySelectorAll({selector!r})].some(e => e.offsetParent !== null && "
        f"e.innerText.includes({text!r}))"
    )


def predicate(test: str) -> str:
    """A condition as a function for the browser, with the helpers that it may use."""
    helpers = "; ".join(f"const {name} = {code}" for name, code in HOLDS.items())
    return f"() => {{ {helpers}; return {test}; }}"


@dataclass
class Row:
    """A row of the table: seconds to what came into view, clicks and letters of the journey.

    ``processor`` are the program's processor seconds meanwhile, all its processes together.
    """

    journey: str
    what: str
    seconds: Mapping[str, float]
    processor: float
    clicks: int
    letters: int
    load: float
    seen: str


@dataclass
class Person:
    """One who clicks and types on a page of a program; ``folder`` takes rows and pictures."""

    page: Any
    program: Any
    journey: str
    folder: Path
    rows: list[Row] = field(default_factory=list)
    clicks: int = 0
    letters: int = 0
    began: float = 0.0
    spent: float = 0.0

    def start_clock(self) -> None:
        """Seconds, and the program's processor seconds, count from here."""
        self.spent, self.began = self.processor(), time.monotonic()

    def processor(self) -> float:
        """Processor seconds of the program and its processes up to now."""
        total = 0.0
        with suppress(psutil.Error):  # a program that has ended
            mine = psutil.Process(self.program.process.pid)
            for process in (mine, *mine.children(recursive=True)):
                with suppress(psutil.Error):
                    taken = process.cpu_times()
                    total += taken.user + taken.system
        return total

    def click(self, selector: str) -> None:
        """One click; the clock begins."""
        self.page.locator(selector).first.wait_for()
        self.clicks += 1
        self.start_clock()
        self.page.locator(selector).first.click()

    def write(self, selector: str, text: str) -> None:
        """A click into a field and what is typed there."""
        self.clicks += 1
        self.letters += len(text)
        self.start_clock()
        self.page.fill(selector, text)

    def drop(self, file: Path) -> None:
        """Choose a file."""
        self.clicks += 1
        self.page.locator("#drop").wait_for()
        self.start_clock()
        self.page.set_input_files("#drop-file", file)

    def pick(self, place: str, option: str) -> None:
        """Choose from a list: a click opens it, another one chooses."""
        self.click(f"{place} .q-select")
        self.click(f".q-menu .q-item:has-text('{option}')")
        self.page.locator(f"{place} .q-select:has-text('{option}')").first.wait_for()

    def system(self, name: str) -> None:
        """Choose the physics that is known of a file just dropped."""
        self.page.locator("#plot-columns .main-svg").first.wait_for()
        self.click(".q-select >> nth=0")
        self.click(f".q-menu .q-item:has-text('{name}')")

    def watch(
        self, what: Mapping[str, str], limit: float = 240.0, last: Sequence[str] = ()
    ) -> dict[str, float]:
        """Seconds since the last click to each of these conditions.

        It ends when all hold, or those of ``last``; what did not come by ``limit`` is left out.
        """
        seen: dict[str, float] = {}
        wanted = set(last) or set(what)
        tests = ", ".join(f"{name}: !!({test})" for name, test in what.items())
        look = predicate(f"({{ {tests} }})")
        while not wanted <= set(seen) and (now := time.monotonic() - self.began) < limit:
            try:
                found = self.page.evaluate(look)
            except Error:  # a page that is just left
                found = {}
            now = time.monotonic() - self.began
            seen.update({name: now for name, holds in found.items() if holds and name not in seen})
            time.sleep(next(step for end, step in _LOOKS if now < end))
        return seen

    def note(self, what: str, seconds: Mapping[str, float], seen: str = "") -> None:
        """A row of the table, and a picture of what is seen."""
        load = os.getloadavg()[0]
        short = {k: float(f"{v:.3g}") for k, v in seconds.items()}
        spent = round(self.processor() - self.spent, 1)
        row = Row(self.journey, what, short, spent, self.clicks, self.letters, round(load, 1), seen)
        self.rows.append(row)
        print(asdict(row), flush=True)
        self.picture(f"{self.journey}-{len(self.rows):02d}-{what}")

    def time(self, what: str, tests: Mapping[str, str], seen: str = "", **how: Any) -> None:
        """Watch, and note what came; ``seen`` is an element whose text is quoted."""
        seconds = self.watch(tests, **how)
        late = sorted(set(tests) - set(seconds) - {"preliminary"})
        told = self.text(seen) if seen else ""
        self.note(what, seconds, "; ".join(filter(None, (told, late and f"not seen: {late}"))))

    def added(self, what: str, selector: str, effect: str = "", limit: float = 400.0) -> None:
        """Click what adds an effect, and note when its parts come."""
        self.page.locator(selector).first.wait_for()
        self.page.evaluate("document.querySelector('#plot-free_run')?.setAttribute('data-old', 1)")
        chips = self.page.locator(".chip.added").count()
        gone = self.page.locator(".gone").count()
        self.click(selector)
        new = f"(document.querySelectorAll('.chip.added').length != {chips} || "
        new += f"document.querySelectorAll('.gone').length != {gone})"
        tests = {name: f"{new} && ({test})" for name, test in LIST.items()}
        seconds = self.watch(tests, limit, ("picture", "ready"))
        self.note(what, seconds, self.verdict())

    def verdict(self) -> str:
        """The error as it stands, and what is said to be missing."""
        self.page.wait_for_timeout(500)  # a list just drawn may be drawn once more
        told = self.text("#error-now"), self.text("#ending, #proposal"), self.text("#caveats")
        return "; ".join(filter(None, told))

    def text(self, selector: str) -> str:
        """The text of the first such element in view, on one line; empty without one."""
        found = self.page.locator(selector).locator("visible=true")
        try:
            said = found.first.inner_text(timeout=500) if found.count() else ""
        except Error:
            said = ""
        return " ".join(said.split())[:400]

    def picture(self, name: str) -> None:
        """A picture of the whole page; none where the browser does not give one in time."""
        plain = re.sub(r"[^\w.]+", "-", name)[:80]
        target = self.folder / "pictures" / f"{plain}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        self.page.evaluate("scrollTo(0, 0)")  # else the bar at the top lies across the middle
        with suppress(Error):
            self.page.screenshot(path=target, full_page=True, timeout=20_000)
