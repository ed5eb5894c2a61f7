"""What a person may ask of a step without taking another: why an effect, and which test to run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from spiral.app.study import why_file
from spiral.inference.problem import Problem, Progress
from spiral.inference.where.latent import MissingForce, missing_force
from spiral.inference.where.own_force import own_force
from spiral.io.curves import Curves
from spiral.io.registry import Registry
from spiral.io.writing import finite, write_whole
from spiral.physics.passivity import implausible
from spiral.types.errors import SpiralError
from spiral.types.model import Model
from spiral.types.record import Record

_SHOWN = 4  # planned tests that are told, beside the record at hand
_KEPT = 8  # steps, and tried effects, that stay in memory: some 10 MB each


def drawn_why(figures: Path, effect: str, before: Curves | None, after: Curves) -> bool:
    """Draw where an effect helps on the test record; whether there was anything to draw."""
    from spiral.view.report.style import hovering
    from spiral.view.report.trial import helped

    figure = None if before is None else helped(before, after)
    if figure is None:
        return False
    figures.mkdir(parents=True, exist_ok=True)
    write_whole(why_file(figures, effect), hovering(figure).to_json())
    return True


def tried(
    figures: Path, effect: str, before: Model, after: Model, record: Record, serial: int,
    known: dict[int, MissingForce | None],
) -> dict[str, Any]:  # fmt: skip
    """What else a trial of an effect shows: its force over the missing one, signs to doubt.

    ``known`` keeps the missing force of the last step that was asked, by its ``serial``.
    """
    if serial not in known:
        known.clear()
        known[serial] = _lacking(before, record)
    signs = {k: v for k, v in implausible(after).items() if k.rsplit(".", 1)[0] == effect}
    return {"pushes": _drawn_force(figures, effect, known[serial], after, record), "signs": signs}


def _lacking(model: Model, record: Record) -> MissingForce | None:
    try:
        return missing_force(model, record)
    except (SpiralError, ArithmeticError, ValueError):  # LinAlgError is a ValueError
        return None


def _drawn_force(
    figures: Path, effect: str, missing: MissingForce | None, after: Model, record: Record
) -> bool:
    """Draw an effect's own force over the missing one; whether it has one."""
    from spiral.view.report.style import hovering
    from spiral.view.report.trial import over_missing

    try:
        own = None if missing is None else own_force(missing, after, effect)
    except (SpiralError, ArithmeticError, ValueError):
        own = None
    if own is None or missing is None:
        return False
    time = record.time[missing.start : missing.stop][own.rows]
    system = after.system
    states = {
        s.name: (s.unit, missing.states[own.rows, missing.task.states.index(s.name)])
        for s in system.states
    }
    figure = over_missing(
        time, missing.force[own.rows], missing.deviation[own.rows], own.alone, own.refitted,
        missing.axes, missing.unit, states,
    )  # fmt: skip
    figures.mkdir(parents=True, exist_ok=True)
    write_whole(why_file(figures, effect, "force"), hovering(figure).to_json())
    return True


def planned(
    problem: Problem, model: Model, effects: Sequence[str], registry: Registry, progress: Progress
) -> Mapping[str, Any]:
    """The tests that tell effects apart best, the record at hand first, in plain data."""
    from spiral.inference.plan import Wanted, plan
    from spiral.inference.plan_options import plan_options
    from spiral.inference.planned_tests import planned_tests, simulator

    chosen, question = plan_options({}), replace(problem, model=model)
    wanted = Wanted(tuple(registry.effect_from_label(e) for e in effects), "", None)
    tests = planned_tests(question, chosen)
    found = plan(question, wanted, tests, simulator(question, registry.simulation), progress)
    names = ("the record at hand", *(o.test.words for o in found.tests))
    rows = [
        {"test": name, "probability": o.probability, "rise": o.noncentrality, "failure": o.failure}
        for name, o in zip(names, (found.now, *found.tests[:_SHOWN]), strict=False)
    ]
    return finite({"effects": list(effects), "rows": rows, "advice": found.advice})


def keep(found: dict[Any, Any], key: Any, value: Any) -> None:
    """Keep a value among the latest few; an earlier one is made anew from disk when asked for."""
    found[key] = value
    for old in list(found)[:-_KEPT]:
        del found[old]
