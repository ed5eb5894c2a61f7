"""Journeys with files of one's own, and with measured records."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from experiments.journeys import made_files
from experiments.journeys.person import LIST, Person, says
from experiments.journeys.rotor import figures
from experiments.journeys.screen import drag
from experiments.journeys.served import Served

BEGIN = "button:has-text('Compare with the model'):enabled"
UNDERSTOOD = {
    "understood": "any('#apart')",
    "free": "[...document.querySelectorAll('button')].some(b => !b.disabled && "
    "b.innerText.includes('Compare with the model'))",
}
FORESEEN = {"forecast": "any('#foresight:not(.soft)')"}
FIRST = {name: LIST[name] for name in ("number", "picture")}
DRAWN = {"picture": "any('#plot-columns .main-svg')"}


def data(name: str) -> Path:
    """A measured file under ``SPIRAL_DATA``."""
    return Path(os.environ.get("SPIRAL_DATA", "../shared/data")).resolve() / name


def dropped(person: Person, served: Served, file: Path, system: str = "oscillator") -> None:
    """From the first page to the picture of a file's columns, and its system."""
    person.page.goto(served.address)
    person.drop(file)
    person.time(f"{file.name}: its columns drawn", DRAWN)
    person.system(system)
    person.page.locator(".mapping").wait_for()


def rig_mapped(person: Person, served: Served, file: Path) -> None:
    """A file with names of its own: each column chosen, two units typed."""
    dropped(person, served, file)
    began = person.began
    for name, column in (("time", "clock"), ("x", "probe 1"), ("force", "hammer")):
        person.pick(f"[data-for='{name}']", column)
    person.write("input[aria-label='unit of time']", "ms")
    person.write("input[aria-label='unit of x']", "um")
    person.page.locator("#units-taken, #apart").first.wait_for()
    taken = person.watch({"samples": says("main", "at 500 Hz"), **UNDERSTOOD})
    whole = {"since the system was chosen": taken["understood"] + person.began - began}
    person.note(
        f"{file.name}: what was understood", {**taken, **whole}, person.text("#units-taken")
    )


def compared(person: Person, what: str, limit: float = 400.0) -> None:
    """Compare with the model, to the first proposal."""
    person.click(BEGIN)
    person.time(what, LIST, "#error-now", limit=limit, last=("picture", "ready"))
    person.rows[-1].seen = person.verdict()


def own_file(person: Person, served: Served) -> None:
    """3000 rows with names and units of their own; test marked; a second and a third file."""
    files = [made_files.rig(served.out, seed) for seed in (1, 2, 3)]
    rig_mapped(person, served, files[0])
    person.time("what the record can tell apart", FORESEEN, "#foresight")
    compared(person, "compared: first figures")
    person.added("Add", "button[aria-label='Add cubic stiffness']:enabled")
    person.clicks = person.letters = 0
    rig_mapped(person, served, files[1])
    page = person.page
    page.locator(BEGIN).wait_for()
    person.click("button:has-text('Mark the test')")
    page.wait_for_function("document.getElementById('plot-columns')?._fullLayout?.meta === 'test'")
    drag(page, 0.1, 0.4)
    person.click("h1")  # the clock begins: the drag itself is no click
    person.clicks -= 1
    person.time("test marked with the mouse", {"read": says("#apart", "rows [")}, "#apart")
    person.click("button:has-text('All rows')")
    page.locator("#apart:has-text('The last part')").wait_for()
    for file, said in ((files[2], "fit: 3000 samples"), (files[0], "fit: 6000 samples")):
        person.drop(file)
        person.time(f"further file {file.name}", {"read": says("main", said)}, "#apart")
    page.locator(BEGIN).wait_for()
    compared(person, "three files compared")


def lost(person: Person, served: Served) -> None:
    """Two lost readings: before and after."""
    dropped(person, served, made_files.lost_readings(served.out))
    person.click("#advice button:has-text('record.fill_gaps=2')")
    person.time("two lost readings", {"drawn": "any('#plot-reading .main-svg')"}, "[role=alert]")


def formula(person: Person, served: Served) -> None:
    """An effect of one's own with a mistake, then corrected; beside its look-alike."""
    rows = made_files.hardening_rows(3000, 1)
    dropped(person, served, made_files.write_rows(served.out / "own.csv", rows))
    compared(person, "compared")
    person.clicks = person.letters = 0
    person.click("text=Write an effect of your own")
    person.write("input[aria-label='Name']", "hardening")
    person.write("input[aria-label='Force on the machine']", "-k3*x**")
    person.click("button:has-text('Test it'):enabled")
    person.time("a mistake in it", {"message": "any('#own-trouble')"}, "#own-trouble")
    person.write("input[aria-label='Force on the machine']", "-k3*q**3")
    person.click("button:has-text('Test it'):enabled")
    add = "any('button[aria-label=\"Add hardening\"]')"
    person.time("corrected, to its rank", {"rank": add, "free": f"{add} && !any('.working')"})
    person.click("button:has-text('Compare them'):enabled")
    person.time("two refitted side by side", {"table": "any('.alike table')"}, ".alike table")
    person.click("button:has-text('Which test tells'):enabled")
    person.time("which test tells them apart", {"plan": "any('#plan table')"}, "#plan")


def units_in_volts(person: Person) -> None:
    """Units typed, and the settings that the messages offer taken."""
    for name, setting in (("x", "position_unit"), ("force", "force_unit")):
        person.write(f"input[aria-label='unit of {name}']", "V")
        take_offer(person, setting)


def take_offer(person: Person, setting: str) -> None:
    """Take a setting that the message at the top offers."""
    offer = f"#advice button:has-text('{setting}')"
    person.click(offer)
    person.page.locator(offer).first.wait_for(state="detached")


def volts(person: Person, served: Served) -> None:
    """A machine in volts."""
    file = made_files.write_rows(
        served.out / "volts.csv", made_files.hardening_rows(3000, 1) * [1, 1e3, 1], "t,out,drive"
    )
    dropped(person, served, file)
    person.pick("[data-for='x']", "out")
    person.pick("[data-for='force']", "drive")
    units_in_volts(person)
    person.time("what was understood", UNDERSTOOD, "#apart")
    compared(person, "compared")


def silverbox(person: Person, served: Served) -> None:
    """Silverbox, measured in volts: 131072 rows."""
    dropped(person, served, data("silverbox/SNLS80mV.csv"))
    began = person.began
    person.pick("[data-for='x']", "V2")
    person.pick("[data-for='force']", "V1")
    person.write("input[aria-label='sample rate']", "610.35")
    units_in_volts(person)
    seconds = person.watch(UNDERSTOOD)
    whole = {"since the system was chosen": seconds["understood"] + person.began - began}
    person.note("what was understood", {**seconds, **whole}, person.text("#apart"))
    compared(person, "compared: first figures", 900.0)
    person.added("Add", ".effect.first button:has-text('Add'):enabled, "
                 "button[aria-label='Add cubic stiffness']:enabled", limit=900.0)  # fmt: skip


def pendulum(person: Person, served: Served) -> None:
    """DFKI's pendulum: nothing typed, then the unit of its torque."""
    for unit in ("", "N*m"):
        person.clicks = person.letters = 0
        dropped(person, served, data("dfki_simple_pendulum/sysid_data_measured.csv"), "pendulum")
        place = "[data-for='theta']"
        if not person.page.locator(f"{place} .q-select:has-text('position')").count():
            person.pick(place, "position")
        if unit:
            person.write("input[aria-label='unit of torque']", unit)
            take_offer(person, "torque_unit")
        take_offer(person, "record.resample")
        person.time(
            f"torque in {unit or 'no unit'}: understood", UNDERSTOOD, "#units-taken", limit=60.0
        )
        compared(person, f"torque in {unit or 'no unit'}: compared")


def million(person: Person, served: Served) -> None:
    """A million samples: all candidates to the first error, two candidates to the end."""
    rows = made_files.hardening_rows(1_000_000, 1)
    file = made_files.write_rows(served.out / "million.csv", rows)
    for more in ("", "candidates=[cubic_stiffness,quadratic_damping]"):
        person.clicks = person.letters = 0
        dropped(person, served, file)
        if more:
            person.click("text=More: candidates, noise")
            person.write("textarea[aria-label^='One KEY=VALUE']", more)
        person.time("what was understood", UNDERSTOOD, "#apart")
        if not more:
            person.click(BEGIN)
            person.time("all candidates: first figures", FIRST)
            person.click("button:has-text('Cancel')")
            continue
        compared(person, "two candidates: first figures", 900.0)
        person.added("Add", "button[aria-label='Add cubic stiffness']:enabled", limit=900.0)
        figures(person)


def bad(person: Person, served: Served) -> None:
    """Eleven bad files."""
    said = ".trouble, #left-out"
    for file in made_files.bad_files(served.out):
        person.clicks = person.letters = 0
        person.page.goto(served.address)
        person.drop(file)
        either = {"said": f"seen('{said}')", "columns": "any('#plot-columns .main-svg')"}
        seconds = person.watch({"first": f"({either['said']}) || ({either['columns']})"})
        if not person.text(said):
            person.system("oscillator")
            seconds = person.watch({"said": either["said"]}, 30.0)
        person.note(file.name, seconds, person.text(said))


JOURNEYS: dict[str, Callable[[Person, Served], None]] = {
    "file": own_file, "lost": lost, "formula": formula, "volts": volts, "bad": bad,
    "pendulum": pendulum, "silverbox": silverbox,
}  # fmt: skip
