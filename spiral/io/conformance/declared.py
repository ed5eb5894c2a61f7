"""What a system declares and what its record holds, in words: not checks, but what was understood.

x' = f(x, u, p): which p are free, where x begins, how u goes on between its samples
"""

from __future__ import annotations

from collections.abc import Iterator

from spiral.types.errors import InputError
from spiral.types.formatting import extent, number
from spiral.types.model import seed_model
from spiral.types.parameter import HELD
from spiral.types.record import Record
from spiral.types.source import Source
from spiral.types.system import System


def describe_declarations(system: System) -> str:
    """Free and known parameters with their values, first states, inputs between their samples."""
    return "; ".join(_declared(system)) or "nothing but its equations"


def _declared(system: System) -> Iterator[str]:
    first = {k: system.defaults.get(k) for k, p in seed_model(system).pairs if p.start is None}
    free = [_valued(k.removeprefix("system."), value) for k, value in first.items()]
    yield "free: " + (", ".join(free) or "none")
    known = [_valued(p.name, p.start) for p in system.parameters if p.start is not None]
    if known:
        yield "known: " + ", ".join(known)
    if written := getattr(system, "written", {}):
        yield "in SI: " + ", ".join(f"{name} from {words}" for name, words in written.items())
    begun = [_valued(s.name, s.start) for s in system.states if s.start]
    if begun:
        yield "begins near: " + ", ".join(begun)
    if own := system.arguments:
        yield "may follow what they multiply: " + ", ".join(f"{p} * ({w})" for p, w in own.values())
    named = [a.name for a in system.auxiliaries if a.name not in own]
    if named:
        yield "named by let, and parameters may follow it: " + ", ".join(named)
    for given in system.inputs:
        if given.derived_from is None:
            open_way = "" if given.interpolation in HELD else "first tried as "
            yield f"{given.name}: {open_way}{given.shape}"


def _valued(name: str, value: float | None) -> str:
    return name if value is None else f"{name} {number(value)}"


def describe_records(source: Source, system: System) -> str:
    """Each record that a source gives a system: its length and rate, and what was done in reading.

    Raises
    ------
    InputError : a source that gives no record.
    """
    records = source.load(system)
    if not records:
        raise InputError("a source without a record", "one at least", "see the source's fields")
    return "; ".join(_describe_record(r) for r in records)


def _describe_record(record: Record) -> str:
    return ". ".join((f"{record.name}: {extent(record.samples, 1 / record.dt)}", *record.remarks))
