"""What a new user meets on the page: seconds, clicks, letters typed, and what was seen.

python -m experiments.journeys run [--only NAME ...] [--out runs/journeys] [--soak-minutes 30]
python -m experiments.journeys list

Rows are kept as each journey ends (rows.json, table.md, pictures/); a journey that is run again
replaces its own.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from experiments.journeys import looks, records, rotor, soak
from experiments.journeys.person import Person
from experiments.journeys.served import HARMLESS, Served, open_browser
from spiral.view.report.pictures import find_browser

JOURNEYS: dict[str, Callable[[Person, Served], None]] = {
    **records.JOURNEYS, **rotor.JOURNEYS, **looks.JOURNEYS, "million": records.million,
}  # fmt: skip


NUMBERS = ("processor", "clicks", "letters", "load")


def travel(name: str, journey: Callable[..., None], folder: Path) -> list[dict[str, Any]]:
    """Rows of one journey, with a program in an empty folder and a browser of its own."""
    program = find_browser()
    if program is None:
        raise SystemExit("no browser: apt install chromium, or set SPIRAL_BROWSER")
    place = Path(tempfile.mkdtemp(prefix=f"journey-{name}-"))
    served = Served(place, {"PYTHONDONTWRITEBYTECODE": ""})
    try:
        with sync_playwright() as playwright:
            window = open_browser(playwright, program, place / "profile")
            person = Person(served.enter(window.pages[0]), served, name, folder)
            walk(person, served, journey)
            window.close()
    finally:
        served.stop()
        shutil.rmtree(place, ignore_errors=True)
    return [asdict(row) for row in person.rows]


def walk(person: Person, served: Served, journey: Callable[..., None]) -> None:
    """One journey; what was measured before it failed is kept, and errors of the page are noted."""
    wrong: list[str] = []
    person.page.on("pageerror", lambda e: wrong.append(str(e)))
    try:
        journey(person, served)
    except Exception:
        traceback.print_exc()
        person.note("failed", {}, traceback.format_exc(limit=-2)[-300:])
    own = [w for w in wrong if not any(known in w for known in HARMLESS)]
    if own:
        person.note("errors in the console", {}, "; ".join(own)[:300])


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = ["| journey | seconds | processor | clicks | letters | load | what was seen |",
             "|---|---|--:|--:|--:|--:|---|"]  # fmt: skip
    for row in rows:
        told = ", ".join(f"{name} {value:g}" for name, value in row["seconds"].items())
        seen = row["seen"].replace("|", "/")[:200]
        numbers = " | ".join(str(row.get(k, "")) for k in NUMBERS)
        lines.append(f"| {row['journey']}: {row['what']} | {told} | {numbers} | {seen} |")
    return "\n".join(lines)


def main() -> None:
    """Run the journeys that are asked for, keep rows and table, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("do", choices=("run", "list"))
    parser.add_argument("--only", nargs="*", choices=[*JOURNEYS, "soak"], default=list(JOURNEYS))
    parser.add_argument("--out", default="runs/journeys", help="folder of the results")
    parser.add_argument("--soak-minutes", type=float, default=30.0)
    given = parser.parse_args()
    if given.do == "list":
        for name, journey in JOURNEYS.items():
            print(f"{name:12} {(journey.__doc__ or '').splitlines()[0]}")
        return
    folder = Path(given.out)
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "rows.json"
    rows: list[dict[str, Any]] = json.loads(kept.read_text()) if kept.exists() else []
    os.environ["SOAK_MINUTES"] = str(given.soak_minutes)
    for name in given.only:
        new = travel(name, {**JOURNEYS, "soak": soak.soak}[name], folder)
        rows = [row for row in rows if row["journey"] != name] + new
        kept.write_text(json.dumps(rows, indent=1))
        (folder / "table.md").write_text(table(rows) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
