"""One study of a machine whose law the catalog does not know."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from experiments.laws.truth import CASES, Case, draw, motion
from experiments.studies.pieces import Row
from spiral.io.registry import load_registry
from spiral.types.record import Record, make_record
from spiral.types.run import Run
from spiral.types.system import System

NOISE = 0.01


def system_of(case: Case, rng: np.random.Generator) -> System:
    """The machine as a user gives it, what is free 5 to 20 % wrong."""
    import spiral

    def rhs(t: Any, x: Any, u: Any, p: Any) -> list[Any]:
        return case.known(list(x), u.force, {k: getattr(p, k) for k in case.values})

    given = {k: (v * _off(rng) if k in case.free else v, unit)
             for k, (v, unit) in case.values.items()}  # fmt: skip
    first = next(iter(case.states))
    return spiral.system(
        rhs, states=case.states, inputs={"force": case.force[3]}, observed=[first],
        parameters=given, free=case.free,
    )  # fmt: skip


def _off(rng: np.random.Generator) -> float:
    return 1 + rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2)


def records_of(name: str, seed: int, share: float) -> tuple[System, Record, Record]:
    """The machine, a record and a test, 1 % noise that nobody declares."""
    case = CASES[name]
    drawn, rng = draw(name, seed)
    system = system_of(case, rng)
    found = []
    for part in (1.0, 0.4):
        clock, states, force = motion(case, drawn, share, rng, part)
        y = states[:, 0]
        y = y + NOISE * y.std() * rng.normal(size=len(y))
        found.append(make_record(system, name, clock, {system.observed[0]: y}, {"force": force}))
    return system, found[0], found[1]


def asked(name: str, seed: int, share: float = 1.0) -> Run:
    """What the default says, the law's own effects left out of the catalog."""
    import spiral

    system, record, test = records_of(name, seed, share)
    known = load_registry(None).candidates(system, everywhere=True)
    kept = [e for e in known if e.plugin_name() not in CASES[name].without]
    return spiral.discover(record, system, test=test, candidates=kept)


def study(name: str, seed: int, share: float = 1.0) -> Row:
    """One study; the law is there to ``share`` (0: nothing is missing)."""
    clock = time.process_time()
    run = asked(name, seed, share)
    last = run.rounds[-1].comparison
    aliases = {x for r in run.rounds for group in r.aliases.values() for x in group}
    right = set(CASES[name].right)
    return {
        "verdict": run.verdict, "missing": list(run.missing),
        "admitted": [x for r in run.rounds for x in r.admitted], "aliases": sorted(aliases),
        "alone": len(run.missing) == 1 and run.missing[0] in right,
        "alike": len(run.missing) == 1 and bool(right & {*run.missing, *aliases}),
        "floors": last.test_error / last.noise_floor, "summary": run.summary,
        "values": {k: (e.estimate, e.se) for label in run.missing
                   for k, e in run.model.estimates()[label].items()},
        "seconds": time.process_time() - clock,
    }  # fmt: skip
