"""Plans the next test: simulates tests and ranks them by how well they distinguish effects.

Each is a record of one of the machines that may be the true one, with the noise of the records at
hand; ``spiral.inference.identifiability.information`` says what such a record tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from spiral.engine.growth import layouts_for
from spiral.engine.study import Layouts, Point
from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.admission import with_effects
from spiral.inference.evidence.assembly import (
    Assembly,
    assemble,
    initial_values,
    to_model,
    with_records,
)
from spiral.inference.evidence.comparison import last_stage, prepare_study, refine_substeps
from spiral.inference.evidence.fit_state import FitState, all_samples
from spiral.inference.evidence.free_run import fit_whole_records
from spiral.inference.identifiability.information import (
    Distinguishability,
    RecordInformation,
    separation_probability,
)
from spiral.inference.problem import Problem, Progress, silent
from spiral.types.display import Readable, Summary
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError, SpiralError, did_you_mean
from spiral.types.formatting import number, percent
from spiral.types.model import Model
from spiral.types.record import Record

ENOUGH = 0.95  # probability with which a proposed test must separate


@dataclass(frozen=True)
class PlannedTest:
    """A test that could be run.

    Parameters
    ----------
    words : what a person would do.
    inputs : input -> description, as ``record.inputs`` takes it; empty for the record at hand.
    duration, rate : s and samples per s.
    unbalance : factor on the unbalance (a trial weight added).
    start : states where the test begins, by name; zero where left out.
    """

    words: str
    inputs: Mapping[str, Any]
    duration: float
    rate: float
    unbalance: float = 1.0
    start: Mapping[str, float] = field(default_factory=dict)


Simulate = Callable[[Model, PlannedTest], Record]
"""(truth, test) -> the noise-free record of it, with its true states."""


@dataclass(frozen=True)
class PlanQuestion:
    """The question: effects to tell apart, or a parameter and the standard error it should have."""

    effects: tuple[Effect, ...] = ()
    parameter: str = ""
    standard_error: float | None = None


@dataclass(frozen=True)
class TestForecast:
    """The expected result of one test.

    ``probability`` of telling all wanted effects apart; ``error`` of the wanted parameter;
    ``noise_share`` noise over the response, mean over channels; ``failure`` why it could not be
    simulated.
    """

    test: PlannedTest
    pairs: tuple[Distinguishability, ...] = ()
    probability: float | None = None
    error: float | None = None
    noise_share: float = 0.0
    failure: str = ""

    @property
    def noncentrality(self) -> float:
        """Of the pair that is hardest to tell apart."""
        return min((p.noncentrality for p in self.pairs), default=0.0)


@dataclass(frozen=True, repr=False)
class Plan(Readable):
    """Planned tests, best first, with the same figures for the record at hand.

    ``suffices``: how many answer the question; the first is the shortest of them. ``model`` is the
    machine they are planned for, ``unit`` that of the wanted parameter.
    """

    wanted: PlanQuestion
    model: Model
    unit: str
    now: TestForecast
    tests: tuple[TestForecast, ...]
    suffices: int
    advice: str
    notes: tuple[str, ...] = ()

    def _shown(self) -> Summary:
        tests = (self.now, *self.tests[:5])
        names = ("the record at hand", *(t.test.words for t in self.tests[:5]))
        rows = tuple(
            (name, percent(t.probability), number(t.noncentrality, 3), number(t.error, 3))
            for name, t in zip(names, tests, strict=True)
        )
        head = ("test", "tells apart", "rise of chi2", "standard error")
        return Summary(f"Plan for {self.model.name}", head, rows, self.advice)

    @property
    def verdict(self) -> Literal["answered", "not_answered"]:
        """Whether a planned test answers the question."""
        return "answered" if self.suffices else "not_answered"


@dataclass(frozen=True)
class _Truth:
    """A model that may be the true one, and the effects that could be mistaken for its own."""

    model: Model
    effect: str
    others: tuple[Effect, ...]
    assembly: Assembly = field(repr=False)


@one_blas_thread
def plan(
    problem: Problem,
    wanted: PlanQuestion,
    tests: Sequence[PlannedTest],
    simulate: Simulate,
    progress: Progress = silent,
) -> Plan:
    """Rank planned tests by what they would tell of a question.

    Parameters
    ----------
    problem : the model and the records at hand. Values that the model lacks are fitted to them;
        every wanted effect is fitted in turn, so that each may be the true one.
    wanted : the question.
    tests : the tests to judge, with the noise of the records at hand.
    simulate : makes a test's noise-free record.

    Raises
    ------
    ConfigError : an unknown parameter, or no effect that can be fitted.
    """
    truths, notes = _fit_truths(problem, wanted, progress)
    now = _outlook_at_hand(problem, truths, wanted)
    outlooks = []
    for count, test in enumerate(tests, 1):
        progress(f"test {count} of {len(tests)}: {test.words}")
        outlooks.append(_outlook_of_test(problem, truths, wanted, test, simulate))
    order = sorted(outlooks, key=lambda o: _sort_key(o, wanted))
    suffices = sum(_is_answer(o, wanted) for o in order)
    model = truths[0].model
    unit = model.unit(wanted.parameter) if wanted.parameter else ""
    advice = _plan_advice(order[0] if order else None, now, wanted, suffices)
    return Plan(wanted, model, unit, now, tuple(order), suffices, advice, notes)


def _is_answer(outlook: TestForecast, wanted: PlanQuestion) -> bool:
    if outlook.failure:
        return False
    if wanted.effects:
        return outlook.probability is not None and outlook.probability >= ENOUGH
    assert outlook.error is not None
    return wanted.standard_error is not None and outlook.error <= wanted.standard_error


def _sort_key(outlook: TestForecast, wanted: PlanQuestion) -> tuple[float, ...]:
    """Tests that answer first, the shortest of them; then the others by what they tell."""
    told = -outlook.noncentrality if wanted.effects else (outlook.error or np.inf)
    if _is_answer(outlook, wanted):
        return (0, outlook.test.duration, outlook.test.unbalance, told)
    return (2 if outlook.failure else 1, told, outlook.test.duration, 0.0)


# --- truths --------------------------------------------------------------------------------------


def _fit_truths(
    problem: Problem, wanted: PlanQuestion, progress: Progress
) -> tuple[tuple[_Truth, ...], tuple[str, ...]]:
    if wanted.parameter:
        known = [k for k, _ in problem.model.pairs]
        if wanted.parameter not in known:
            raise ConfigError(
                f"plan.parameter={wanted.parameter}",
                f"a parameter of the model: {', '.join(known)}",
                did_you_mean(wanted.parameter, known),
            )
        progress("fitting the model")
        return (_compile_truth(problem, _fit_model(problem, None, progress), "", ()),), ()
    seeded = [e.label for e in problem.model.system.seed]
    base = problem.model
    for effect in wanted.effects:
        if effect.label in base.labels and effect.label not in seeded:
            base = base.without(effect.label)
    truths, notes = [], []
    for effect in wanted.effects:
        progress(f"fitting {effect.label} as the true one")
        present = effect.label in problem.model.labels
        model = problem.model if present else base
        try:
            fitted = _fit_model(
                replace(problem, model=model), None if present else effect, progress
            )
        except SpiralError as error:
            notes.append(f"{effect.label} could not be fitted: {error.given}")
            continue
        others = tuple(e for e in wanted.effects if e is not effect)
        truths.append(_compile_truth(problem, fitted, effect.label, others))
    if not truths:
        raise ConfigError("; ".join(notes), "an effect that can be fitted to the record at hand")
    return tuple(truths), tuple(notes)


def _compile_truth(
    problem: Problem, model: Model, effect: str, others: tuple[Effect, ...]
) -> _Truth:
    """A fitted machine compiled with the effects that could be taken for its own."""
    beside = tuple(e for e in others if e.label not in model.labels)
    assembly = assemble(replace(problem, model=model, candidates=beside))
    assembly = refine_substeps(assembly, FitState(model.labels, initial_values(assembly)))
    return _Truth(model, effect, others, assembly)


def _fit_model(problem: Problem, effect: Effect | None, progress: Progress) -> Model:
    """The model, with one more effect where asked, with a value for every parameter."""
    model = problem.model
    missing = [
        k for k in model.active if k not in model.values and not _is_record_parameter(model, k)
    ]
    if effect is None and not missing:
        return model
    wider = () if effect is None else (effect,)
    assembly, fit_state = prepare_study(problem, wider)
    stage = last_stage(assembly, fit_state, all_samples(assembly))
    fit_state = replace(fit_state, values=stage.fitted.point.values)
    if effect is not None:
        fit_state = with_effects(assembly, fit_state, wider, progress)
        stage = last_stage(assembly, fit_state, all_samples(assembly))
    if not np.isfinite(stage.fitted.cost):
        raise ConfigError(f"{' '.join(fit_state.labels)}, which diverges on the record", "a fit")
    return to_model(assembly, fit_state.labels, stage.fitted.point.values, {}, fit_state.freed)


def _is_record_parameter(model: Model, key: str) -> bool:
    return dict(model.pairs)[key].scope == "record"


# --- what a test tells ---------------------------------------------------------------------------


def _outlook_at_hand(
    problem: Problem, truths: tuple[_Truth, ...], wanted: PlanQuestion
) -> TestForecast:
    """The forecast for the records at hand, with their inputs and fitted initial states."""
    first = problem.records[0]
    test = PlannedTest("the record at hand", {}, first.samples * first.dt, 1.0 / first.dt)
    pairs: list[Distinguishability] = []
    error = None
    for truth in truths:
        values = initial_values(truth.assembly)
        stage = fit_whole_records(truth.assembly, truth.model.labels, values)
        view = RecordInformation.of(truth.assembly, stage.layouts, stage.fitted.point)
        pairs += view.pairs(truth.effect, truth.others)
        error = view.standard_error(wanted.parameter) if wanted.parameter else None
    return TestForecast(
        test, tuple(pairs), separation_probability(pairs, problem.settings.alias_level), error
    )


def _outlook_of_test(
    problem: Problem,
    truths: tuple[_Truth, ...],
    wanted: PlanQuestion,
    test: PlannedTest,
    simulate: Simulate,
) -> TestForecast:
    """The forecast for a planned test, with the noise of the records at hand."""
    pairs: list[Distinguishability] = []
    error, shares = None, []
    for truth in truths:
        try:
            record, model = _simulate_planned(problem, truth, test, simulate)
        except SpiralError as failed:
            return TestForecast(test, failure=failed.given)
        shares.append(np.mean([s / np.std(record.channels[c]) for c, s in record.sigma().items()]))
        knot = problem.settings.phase_knot
        one = replace(truth.assembly.problem, model=model, records=(record,))
        steps = truth.assembly.study.series[0].substeps
        assembly = with_records(replace(truth.assembly, problem=one), (record,), steps, knot)
        assembly = refine_substeps(assembly, FitState(model.labels, initial_values(assembly)))
        view = RecordInformation.of(assembly, *_window_from_truth(assembly, record))
        pairs += view.pairs(truth.effect, truth.others)
        error = view.standard_error(wanted.parameter) if wanted.parameter else None
    share = float(np.mean(shares))
    return TestForecast(
        test,
        tuple(pairs),
        separation_probability(pairs, problem.settings.alias_level),
        error,
        share,
    )


def _simulate_planned(
    problem: Problem, truth: _Truth, test: PlannedTest, simulate: Simulate
) -> tuple[Record, Model]:
    """The noise-free record of a test with the noise declared, and the model it came from."""
    scaled = {
        f"{e.label}.{p.name}": test.unbalance
        for e in truth.model.effects
        if e.undirected()
        for p in e.amplitudes()
    }
    values = {k: v * scaled.get(k, 1.0) for k, v in truth.model.values.items()}
    model = replace(truth.model, values=values)
    record = simulate(model, test)
    noise = {c: float(np.mean([r.sigma()[c] for r in problem.records])) for c in record.channels}
    return replace(record, noise=noise), model


def _window_from_truth(assembly: Assembly, record: Record) -> tuple[Layouts, Point]:
    """One window over the whole record, started from its true state."""
    traced = assembly.study.compiled.traced
    start = [float(record.truth[s][0]) if s in record.truth else 0.0 for s in traced.states]
    layouts = layouts_for(assembly.study, record.samples, (None,))
    return layouts, Point(initial_values(assembly), (np.array([start]),))


def _plan_advice(
    best: TestForecast | None, now: TestForecast, wanted: PlanQuestion, suffices: int
) -> str:
    if best is None or best.failure:
        return "No planned test could be simulated."
    if wanted.effects:
        names = " and ".join(e.label for e in wanted.effects)
        here = f"The record at hand tells {names} apart with probability {now.probability:.0%}. "
        if suffices:
            return f"{here}Run: {best.test.words} (probability {best.probability:.0%})."
        return (
            f"{here}No planned test reaches {ENOUGH:.0%}; the best, {best.test.words}, has "
            f"{best.probability:.0%}. Give longer or wider ones: plan.durations, plan.speeds, "
            "plan.unbalances, plan.amplitudes."
        )
    here = f"The record at hand gives {wanted.parameter} a standard error of {now.error:.3g}. "
    if suffices:
        return f"{here}Run: {best.test.words} ({best.error:.3g})."
    if wanted.standard_error is None:
        return f"{here}Best: {best.test.words} ({best.error:.3g})."
    return (
        f"{here}No planned test reaches {wanted.standard_error:.3g}; the best, "
        f"{best.test.words}, gives {best.error:.3g}. Give longer or wider ones: plan.durations, "
        "plan.speeds, plan.amplitudes."
    )
