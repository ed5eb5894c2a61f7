"""``strategy=likelihood``: the whole record's likelihood decides, with a model of what is random.

several starts -> most likely values and noise -> score, race and judge the candidates ->
admission, where no horizon on unseen data grows worse -> refit, noise and effects that are
no longer wanted let go.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.likelihood.fit import informed
from spiral.engine.statistics import spent
from spiral.inference.acting import random_forces
from spiral.inference.evidence.admission import cannot_be_asked, second_order
from spiral.inference.evidence.assembly import Assembly, check_candidates, compiled_with, offers
from spiral.inference.evidence.comparison import refined
from spiral.inference.evidence.fit_state import FitState, Masks, begin, half_masks
from spiral.inference.evidence.scoring import Ranked, Ranking, tested_keys
from spiral.inference.likelihood.between import (
    likelier_inputs,
    with_likely_inputs,
    with_own_inputs,
)
from spiral.inference.likelihood.candidates import (
    Race,
    Rival,
    held_shapes,
    race,
    refit_alone,
    with_own_shapes,
)
from spiral.inference.likelihood.comparison import compared_by_likelihood
from spiral.inference.likelihood.fitting import (
    WARM,
    LikelihoodFit,
    colour,
    price,
    refitted,
    restarted,
    taken_on,
)
from spiral.inference.likelihood.groups import alike, plainest
from spiral.inference.likelihood.identify import untold
from spiral.inference.likelihood.judging import Unselected, judged, unselected
from spiral.inference.likelihood.ladder import climbed_ladder, pruned, quieted
from spiral.inference.likelihood.scores import ranking
from spiral.inference.likelihood.starts import (
    best_fit,
    on_finer_steps,
    rebalanced,
    resolved_in_time,
)
from spiral.inference.likelihood.suggestions import suggestions
from spiral.inference.problem import Problem, Progress, Settings, silent
from spiral.inference.strategies.base import Begun, Settled, Step
from spiral.inference.strategies.remembered import missing_memory
from spiral.inference.strategies.retire import let_go
from spiral.inference.strategy_options import LikelihoodOptions, ShootingOptions
from spiral.inference.unknown.holding import carried, emptied, having
from spiral.inference.unknown.shape import applies, unknown_shape
from spiral.inference.verdict import near_noise
from spiral.types.errors import ConfigError
from spiral.types.horizon import changes
from spiral.types.run import Comparison, Suggestion

_LAST = 1e-6  # whiteness from which a model may be the last
_BOUND = 0.99  # share of the largest random force from which one stands at its bound


def begin_study(problem: Problem, progress: Progress) -> Begun:
    """The model as it is, most likely with the noise that its record wants."""
    progress("compiling the model")
    settings = replace(problem.settings, phase_knot=0.0)  # the filter tracks the phase itself
    problem = replace(problem, settings=settings)
    check_candidates(problem)
    bare = compiled_with(problem, (), 1)
    state = replace(begin(bare, problem.model.labels), corrected=False)
    bare = refined(bare, state)
    found = best_fit(bare, state, progress)
    for effect in problem.model.effects:
        keys = tuple(k for k in problem.scaled if k.rsplit(".", 1)[0] == effect.label)
        found = with_own_shapes(bare, found, effect, keys)
    found = finished(bare, found, progress)
    if not problem.candidates:
        run = with_likely_inputs(bare, found, progress)
        found = found if run is found else finished(bare, pruned(bare, run, progress), progress)
    settled = _settled(bare, found, progress)
    fitted = replace(problem, model=settled.comparison.model)
    variants, left_out, _ = offers(fitted, bare.later)
    assembly = replace(bare, offered=tuple(variants), left_out=left_out, bare=True)
    groups = untold(found)
    return Begun(
        assembly, settled.standing, settled.comparison, settled.details, bool(groups), groups
    )


def _settled(
    assembly: Assembly, found: LikelihoodFit, progress: Progress, retired: tuple[str, ...] = ()
) -> Settled:
    """A fit on all samples as the state of the study, compared with the test records."""
    found = replace(found, estimate=informed(found.estimate))
    state, comparison = compared_by_likelihood(assembly, found, progress)
    details: dict[str, Any] = {"noise": dict(found.estimate.noise.values)}
    if found.estimate.finite:
        details["log_likelihood"] = found.height
    return Settled(state, comparison, retired, details)


@dataclass(frozen=True)
class Scored:
    """What a round found: candidates by their score, and those refitted.

    ``settled`` is the study with what is admitted, if anything is.
    """

    ranking: Ranking
    rivals: tuple[Rival, ...]
    settled: Settled | None = None


def propose(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, comparison: Comparison,
    number: int, progress: Progress,
) -> Step[Scored]:  # fmt: skip
    """The candidate that makes the record most likely, if it passes on other blocks."""
    assembly = having(assembly, state.labels)
    masks = select, judge = half_masks(assembly)
    progress("scoring candidates by one-step predictions")
    base = refitted(assembly, state, masks=select, steps=WARM, rough=True)
    if (ranked := ranking(assembly, base, base.estimate.noise, select)) is None:
        return Step((), {}, stopped="diverged")
    run = race(assembly, base, list(ranked.ranked), select, progress, options.rivals)
    least = run.best - np.log(options.odds)  # what is not told apart is no effect
    if (other := likelier_inputs(assembly, base, select, least, progress)) is not None:
        return _otherwise(options, assembly, other.state, number, progress)
    level = spent(assembly.problem.settings.level, number) / options.judged
    passed, rejected = _first_to_pass(
        options, assembly, base, run, judge, level, comparison, progress
    )
    if passed is not None:
        effect, aliases = passed.rival.ranked.variant.original, passed.aliases
        return Step(
            suggestions(run.tried, ranked, effect.label, aliases)[: options.listed], rejected,
            (effect.label,), {effect.label: aliases}, second_order(effect, assembly, state),
            effect.meaning(), found=Scored(ranked, run.tried, passed.settled),
        )  # fmt: skip
    step = Step(suggestions(run.tried, ranked, "", ())[: options.listed], rejected,
                found=Scored(ranked, run.tried))  # fmt: skip
    if near_noise(comparison, assembly.problem.settings):
        step = replace(step, stopped="whiteness")
    memory = missing_memory(assembly, base, comparison, masks, progress)
    if memory is not None:  # a curve over the present state would only stand in for it
        return replace(step, stopped="no_candidate", details={"memory": memory.as_dict()})
    return _with_curve(assembly, state, step, masks, number, progress)


@dataclass(frozen=True)
class _Passed:
    """A candidate that passed, those that the records do not tell from it, the model with it."""

    rival: Rival
    aliases: tuple[str, ...]
    settled: Settled


def _first_to_pass(
    options: LikelihoodOptions, assembly: Assembly, base: LikelihoodFit, run: Race, judge: Masks,
    level: float, comparison: Comparison, progress: Progress,
) -> tuple[_Passed | None, dict[str, str]]:  # fmt: skip
    """The first winner that holds on other blocks and helps, and why those before it do not."""
    rejected: dict[str, str] = {}
    ours = functools.cache(lambda: unselected(base, assembly, judge))
    for rival, rivals in itertools.islice(run.winners(), options.judged):
        if reason := _refused(base, ours, rival, judge, level):
            rejected[rival.label] = reason
            continue
        chosen, aliases = plainest(rival, alike(rivals, options.odds), rivals)
        progress(f"most likely values with {chosen.label}")
        settled = _with(chosen.assembly, chosen.fit.state, chosen.ranked.variant.label, progress)
        reason = _unhelpful(options, comparison, settled.comparison, assembly.problem.settings)
        if not reason:
            return _Passed(chosen, aliases, settled), rejected
        rejected[chosen.label] = reason
    return None, rejected


def _otherwise(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, number: int,
    progress: Progress,
) -> Step[Scored]:  # fmt: skip
    """The proposal beside the model as it is with inputs that run otherwise between samples."""
    found = pruned(assembly, refitted(assembly, state, rough=True), progress)
    found = finished(assembly, found, progress)
    again = _settled(assembly, found, progress)
    step = propose(options, assembly, again.standing, again.comparison, number, progress)
    return replace(step, again=step.again or again)


def _with_curve(
    assembly: Assembly, state: FitState, step: Step[Scored], masks: tuple[Masks, Masks],
    number: int, progress: Progress,
) -> Step[Scored]:  # fmt: skip
    """The step with the curve of what no candidate explains, where there is one.

    It is found on windows (``spiral.inference.unknown``), and admitted where the settings say so.
    """
    if step.stopped == "whiteness" or not applies(assembly):
        return step
    found = unknown_shape(ShootingOptions(), assembly, state, masks, number, progress)
    if found is None:
        return step
    details = {**step.details, "unknown": found.shape.as_dict()}
    admitted = found.proposal.admitted
    if not assembly.problem.settings.learned or admitted is None:
        return replace(step, details=details)
    variant = admitted.variant
    own = having(assembly, admitted.standing.labels)
    wider = replace(carried(admitted.standing, found.assembly, own), noise=None, corrected=False)
    progress(f"most likely values with {variant.original.label}")
    settled = _with(own, wider, variant.label, progress)
    gone = (*settled.retired, *found.proposal.dropped)
    return replace(
        step, admitted=(variant.original.label,), meaning=variant.original.meaning(),
        details=details, found=replace(step.needed(), settled=replace(settled, retired=gone)),
    )  # fmt: skip


def finished(assembly: Assembly, found: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """The fit with the noise that its record wants.

    It is at its very maximum where the model may be the last: its misses are white.
    """
    found = rebalanced(assembly, climbed_ladder(assembly, found, progress), progress)
    if not found.estimate.finite or colour(assembly, found).p < _LAST:
        return found
    progress("polishing the fit")
    return resolved_in_time(assembly, taken_on(assembly, quieted(assembly, found)))


def _refused(
    base: LikelihoodFit, ours: Callable[[], Unselected], rival: Rival, judge: Masks, level: float
) -> str:
    if not rival.worth > 0:
        return "refitted, it does not make the record more likely than its price"
    found = judged(base, ours(), rival, judge)
    if not found.passes(level):
        return (
            f"not confirmed on the blocks that did not select (p = {found.p_value:.2g}, "
            f"log-likelihood {found.predicted:+.3g} as it was fitted)"
        )
    return ""


def _unhelpful(
    options: LikelihoodOptions, before: Comparison, after: Comparison, settings: Settings
) -> str:
    """Why an effect does no good to what is predicted; empty where it does.

    The squared error that it takes away, over what is left, is a size in standard deviations of
    the noise; the largest over the horizons and the free run of the fitted records counts.
    """
    forces = max(random_forces(after).values(), default=0.0)
    if forces >= _BOUND * options.random_limit:
        return (
            "with it, too, a random force as large as the machine's own would have to act: the "
            "model has not found its values, or is of another machine"
        )
    judged_ = changes(before.unseen, after.unseen)
    for change in judged_:
        if change.judged == "worse":
            return (
                f"the error on unseen data grows ({change.horizon}: {100 * change.before:.3g} -> "
                f"{100 * change.after:.3g} %)"
            )
    pairs = [(before.fit_error, after.fit_error), *((c.before, c.after) for c in judged_)]
    sizes = [np.sqrt(max((b / a) ** 2 - 1, 0.0)) if a > 0 else np.inf for b, a in pairs]
    size = float(max(x if np.isfinite(x) else np.inf for x in sizes))
    if size >= settings.smallest:
        return ""
    return (
        f"significant, but too small to matter: at no horizon does it take away more than "
        f"{size:.2g} of what is left (least {settings.smallest:g})"
    )


def _with(own: Assembly, state: FitState, label: str, progress: Progress) -> Settled:
    """The model with a candidate, fitted to all samples; noise and effects not wanted any more go.

    Parameters
    ----------
    own : the study with the candidate. state : in its terms. label : the candidate's, compiled.
    """
    found = refitted(own, state, rough=True)
    found = restarted(own, on_finer_steps(own, found))
    found, effect = pruned(own, found, progress), own.variant(label).effect
    found = with_own_shapes(own, found, effect, held_shapes(own, found, effect))
    found = finished(own, with_own_inputs(own, found, progress), progress)
    found, gone = _without_superfluous(own, found, label)
    settled = _settled(own, found, progress, gone)
    if not gone:
        return settled
    final = having(emptied(own), settled.standing.labels)
    return replace(settled, standing=carried(settled.standing, own, final))


def _without_superfluous(
    assembly: Assembly, found: LikelihoodFit, latest: str
) -> tuple[LikelihoodFit, tuple[str, ...]]:
    """Effects admitted before that the record no longer wants, let go."""
    gone: list[str] = []
    for label in found.state.labels:
        if label in assembly.problem.model.labels or label == latest:
            continue
        keys = tested_keys(assembly, assembly.variant(label))
        values, errors = found.estimate.values, found.estimate.errors
        least = assembly.problem.settings.least_t
        if any(abs(values.get(k, 0.0)) > least * errors.get(k, np.inf) for k in keys):
            continue
        trial = refitted(assembly, let_go(assembly, found.state, (label,)))
        if trial.height > found.height - price(len(keys), trial.estimate.prepared):
            found = trial
            gone.append(assembly.variant(label).original.label)
    return found, tuple(gone)


def settle(step: Step[Scored]) -> Settled:
    """What was refitted and compared when it was proposed."""
    settled = step.needed().settled
    assert settled is not None
    return settled


def ranked_by_worth(step: Step[Scored]) -> tuple[Suggestion, ...]:
    """All candidates in one order, whatever is proposed; none where the fit has diverged."""
    if step.found is None:
        return ()
    scored = step.found
    label = next(iter(step.admitted), "")
    found = suggestions(scored.rivals, scored.ranking, label, step.aliases.get(label, ()))
    return tuple(sorted(found, key=lambda s: -(s.net or 0.0)))


def choose(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, step: Step[Scored], label: str
) -> Step[Scored]:
    """Another candidate in place of the proposal; no gate is asked."""
    scored = step.needed()
    assembly = having(assembly, state.labels)
    rival = next((r for r in scored.rivals if r.label == label), None)
    if rival is None:
        base = refitted(assembly, state, steps=WARM, rough=True)
        rival = refit_alone(assembly, base, _of(assembly, scored.ranking, label))
    settled = _with(rival.assembly, rival.fit.state, rival.ranked.variant.label, silent)
    effect = next(v.original for v in assembly.offered if v.original.label == label)
    group = set(step.admitted) | {x for v in step.aliases.values() for x in v}
    aliases = tuple(sorted(group - {label})) if label in group else ()
    return replace(
        step, suggestions=ranked_by_worth(step)[: options.listed], admitted=(label,),
        aliases={label: aliases},
        second_order=second_order(effect, assembly, state), meaning=effect.meaning(),
        found=replace(scored, settled=settled),
    )  # fmt: skip


def admit(assembly: Assembly, state: FitState, label: str, progress: Progress) -> Settled:
    """An effect admitted by its name, with the shapes that the record prefers."""
    assembly = having(assembly, state.labels)
    base = refitted(assembly, state, steps=WARM, rough=True)
    progress(f"refitting with {label}")
    found = ranking(assembly, base, base.estimate.noise, None)
    if found is None:
        raise ConfigError(f"add {label}", "a model whose fit does not diverge",
                          "check units and signs of the channels")  # fmt: skip
    rival = refit_alone(assembly, base, _of(assembly, found, label))
    return _with(rival.assembly, rival.fit.state, rival.ranked.variant.label, progress)


def _of(assembly: Assembly, found: Ranking, label: str) -> Ranked:
    """The best variant of an effect among those ranked."""
    for ranked in found.ranked:
        if ranked.variant.original.label == label:
            return ranked
    raise cannot_be_asked(assembly, label)
