"""Figures of the trial of an effect, and tests that distinguish effects; no study is changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from spiral.app.study import trial_figure_file
from spiral.inference.problem import Problem, Progress
from spiral.inference.where.latent import MissingForce, missing_force
from spiral.inference.where.own_force import effect_own_force
from spiral.io.curves import Curves
from spiral.io.registry import Registry
from spiral.io.writing import replace_nonfinite, write_whole
from spiral.physics.passivity import implausible_signs
from spiral.types.errors import SpiralError
from spiral.types.label import owner_of
from spiral.types.model import Model
from spiral.types.record import Record
from spiral.view.report.style import label_words

_SHOWN = 4  # planned tests that are listed, beside the record at hand
_KEPT = 8  # steps, and tried effects, that stay in memory: some 10 MB each


def draw_benefit_figure(figures: Path, effect: str, before: Curves | None, after: Curves) -> bool:
    """Draw where an effect helps on the test record; whether there was anything to draw."""
    from spiral.view.report.style import add_hover_text
    from spiral.view.report.trial import residual_comparison

    figure = None if before is None else residual_comparison(before, after)
    if figure is None:
        return False
    figures.mkdir(parents=True, exist_ok=True)
    write_whole(trial_figure_file(figures, effect), add_hover_text(figure).to_json())
    return True


def trial_details(
    figures: Path, effect: str, before: Model, after: Model, record: Record, serial: int,
    known: dict[int, MissingForce | None],
) -> dict[str, Any]:  # fmt: skip
    """Draw an effect's force over the missing one; whether it has one, and its doubtful signs.

    ``known`` keeps the missing force of the last step that was asked, by its ``serial``.
    """
    if serial not in known:
        known.clear()
        known[serial] = _missing_force_or_none(before, record)
    signs = {k: v for k, v in implausible_signs(after).items() if owner_of(k) == effect}
    return {
        "pushes": _draw_effect_force(figures, effect, known[serial], after, record),
        "signs": signs,
    }


def _missing_force_or_none(model: Model, record: Record) -> MissingForce | None:
    try:
        return missing_force(model, record)
    except (SpiralError, ArithmeticError, ValueError):  # LinAlgError is a ValueError
        return None


def _draw_effect_force(
    figures: Path, effect: str, missing: MissingForce | None, after: Model, record: Record
) -> bool:
    """Draw an effect's own force over the missing one; whether it has one."""
    from spiral.view.report.style import add_hover_text
    from spiral.view.report.trial import missing_force_comparison

    try:
        own = None if missing is None else effect_own_force(missing, after, effect)
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
    figure = missing_force_comparison(
        time, missing.force[own.rows], missing.deviation[own.rows], own.alone, own.refitted,
        missing.axes, missing.unit, states,
    )  # fmt: skip
    figures.mkdir(parents=True, exist_ok=True)
    write_whole(trial_figure_file(figures, effect, "force"), add_hover_text(figure).to_json())
    return True


def rank_discriminating_tests(
    problem: Problem, model: Model, effects: Sequence[str], durations: Sequence[float],
    registry: Registry, progress: Progress,
) -> Mapping[str, Any]:  # fmt: skip
    """The tests that tell effects apart best, the record at hand first, in plain data.

    ``durations`` in s; without any they follow from the record at hand.
    """
    from spiral.inference.plan import PlanQuestion, plan
    from spiral.inference.plan_options import plan_options
    from spiral.inference.planned_tests import planned_tests, simulator

    chosen = plan_options({"durations": tuple(durations)})
    question = replace(problem, model=model)
    wanted = PlanQuestion(tuple(registry.effect_from_label(e) for e in effects), "", None)
    tests = planned_tests(question, chosen)
    ranking = plan(question, wanted, tests, simulator(question, registry.simulation), progress)
    names = ("the record at hand", *(o.test.words for o in ranking.tests))
    rows = [
        {"test": name, "probability": o.probability, "rise": o.noncentrality, "failure": o.failure}
        for name, o in zip(names, (ranking.now, *ranking.tests[:_SHOWN]), strict=False)
    ]
    advice, _, settings = ranking.advice.partition(" Give longer or wider ones")
    for label in effects:
        advice = advice.replace(label, label_words(label))
    tried = sorted({o.test.duration for o in ranking.tests}) if settings else []
    return replace_nonfinite(
        {"effects": list(effects), "rows": rows, "advice": advice, "tried": tried}
    )


def keep_latest(store: dict[Any, Any], key: Any, value: Any) -> None:
    """Keep a value among the latest few; an earlier one is made anew from disk when asked for."""
    store[key] = value
    for old in list(store)[:-_KEPT]:
        del store[old]
