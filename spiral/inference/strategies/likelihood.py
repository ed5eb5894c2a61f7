"""``strategy=likelihood``: the whole record's likelihood decides, with a model of what is random.

    several starts -> most likely values and noise -> score, race and judge the candidates ->
    admission, where no horizon on unseen data grows worse -> refit, noise and effects that are
    no longer wanted let go.

Windows (``strategy=shooting``) are one of the starts.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.likelihood.fit import informed
from spiral.engine.statistics import spent
from spiral.inference.evidence.assembly import Assembly, check_candidates, compiled_with, offers
from spiral.inference.evidence.comparison import refined
from spiral.inference.evidence.fit_state import FitState, Masks, begin, half_masks
from spiral.inference.evidence.scoring import Ranked, Ranking, tested_keys
from spiral.inference.likelihood.candidates import (
    Rival,
    alike,
    judged,
    machine_first,
    race,
    refit_alone,
)
from spiral.inference.likelihood.comparison import compared_by_likelihood
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    colour,
    price,
    refitted,
    restarted,
    taken_on,
)
from spiral.inference.likelihood.identify import untold
from spiral.inference.likelihood.ladder import climbed_ladder, pruned, quieted
from spiral.inference.likelihood.memory import memory_of
from spiral.inference.likelihood.scores import ranking
from spiral.inference.likelihood.starts import (
    best_fit,
    on_finer_steps,
    rebalanced,
    resolved_in_time,
)
from spiral.inference.problem import Problem, Progress, Settings, silent
from spiral.inference.strategies.base import Begun, Settled, Step, Strategy, second_order
from spiral.inference.strategies.retire import let_go
from spiral.inference.suggest import by_evidence
from spiral.inference.unknown.holding import carried, emptied, having
from spiral.inference.unknown.memory import Memory
from spiral.inference.unknown.shape import applies, unknown_shape
from spiral.inference.verdict import near_noise, random_forces
from spiral.types.effect import InputEffect
from spiral.types.errors import ConfigError
from spiral.types.horizon import changes
from spiral.types.run import Comparison, Stopped, Suggestion

_LAST = 1e-6  # whiteness from which a model may be the last
_WARM = 6  # scoring steps from the values on all samples to those on the selecting half
_ASKED = 3  # rivals that may be judged in one round
_LISTED = 5
_OWN = 1.0  # random force, over the machine's own, beside which no term of the model is told


def _begin(problem: Problem, progress: Progress) -> Begun:
    progress("compiling the model")
    settings = replace(problem.settings, phase_knot=0.0)  # the filter tracks the phase itself
    problem = replace(problem, settings=settings)
    check_candidates(problem)
    bare = compiled_with(problem, (), 1)
    state = replace(begin(bare, problem.model.labels), corrected=False)
    bare = refined(bare, state)
    found = finished(bare, best_fit(bare, state, progress), progress)
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


def _propose(
    assembly: Assembly, state: FitState, comparison: Comparison, number: int, progress: Progress
) -> Step:
    assembly = having(assembly, state.labels)
    select, judge = half_masks(assembly)
    progress("scoring candidates by one-step predictions")
    base = refitted(assembly, state, masks=select, steps=_WARM, rough=True)
    ranked = ranking(assembly, base, base.estimate.noise, select)
    if ranked is None:
        return Step((), {}, stopped="diverged")
    run = race(assembly, base, list(ranked.ranked), select, progress)
    rejected: dict[str, str] = {}
    level = spent(assembly.problem.settings.level, number) / _ASKED
    for rival, rivals in itertools.islice(run.winners(), _ASKED):
        reason = _refused(assembly, base, rival, judge, level)
        if reason:
            rejected[rival.label] = reason
            continue
        chosen, aliases = machine_first(rival, alike(rivals), rivals)
        progress(f"most likely values with {chosen.label}")
        settled = _with(chosen.assembly, chosen.fit.state, chosen.ranked.variant.label, progress)
        reason = _unhelpful(comparison, settled.comparison, assembly.problem.settings)
        if reason:
            rejected[chosen.label] = reason
            continue
        effect = chosen.ranked.variant.original
        return Step(
            _suggestions(run.tried, ranked, effect.label, aliases)[:_LISTED], rejected,
            (effect.label,), {effect.label: aliases}, second_order(effect, assembly, state),
            effect.meaning(), found=Scored(ranked, run.tried, settled),
        )  # fmt: skip
    near = near_noise(comparison, assembly.problem.settings)
    stopped: Stopped = "whiteness" if near else "no_candidate"
    step = Step(_suggestions(run.tried, ranked, "", ())[:_LISTED], rejected, stopped=stopped,
                found=Scored(ranked, run.tried))  # fmt: skip
    memory = _memory(assembly, base, comparison, (select, judge), progress)
    if memory is not None:  # a curve over the present state would only stand in for it
        return replace(step, stopped="no_candidate", details={"memory": memory.as_dict()})
    return step if near else _with_curve(assembly, state, step, (select, judge), number, progress)


def _memory(
    assembly: Assembly, base: LikelihoodFit, comparison: Comparison, masks: tuple[Masks, Masks],
    progress: Progress,
) -> Memory | None:  # fmt: skip
    """The memory of what is missing, where it has any.

    Effects without memory that were admitted, and a random force or coloured noise beside them, may
    have stood in for it: it is then looked for in what the model without them lacks, too, and must
    be more likely than they are.
    """
    found = memory_of(assembly, base, masks, progress)
    held = {v.label: v.effect for v in assembly.variants if v.label in base.state.labels}
    gone = tuple(x for x, e in held.items() if not (e.states or isinstance(e, InputEffect)))
    near = near_noise(comparison, assembly.problem.settings) and not comparison.random
    if found is not None or near or not gone:
        return found
    before = refitted(assembly, replace(let_go(assembly, base.state, gone), noise=None), rough=True)
    before = climbed_ladder(assembly, before, progress)
    if not before.estimate.finite:
        return None
    before = refitted(assembly, before.state, masks=masks[0], steps=_WARM, rough=True)
    return memory_of(assembly, before, masks, progress, base)


def _with_curve(
    assembly: Assembly, state: FitState, step: Step, masks: tuple[Masks, Masks], number: int,
    progress: Progress,
) -> Step:  # fmt: skip
    """The step with the curve of what no candidate explains, where there is one.

    It is found on windows (``spiral.inference.unknown``), and admitted where the settings say so.
    """
    if not applies(assembly):
        return step
    found = unknown_shape(assembly, state, masks, number, progress)
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
        details=details, found=replace(step.found, settled=replace(settled, retired=gone)),
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
    assembly: Assembly, base: LikelihoodFit, rival: Rival, judge: Masks, level: float
) -> str:
    if not rival.worth > 0:
        return "refitted, it does not make the record more likely than its price"
    found = judged(assembly, base, rival, judge)
    if not found.passes(level):
        return (
            f"not confirmed on the blocks that did not select (p = {found.p_value:.2g}, "
            f"log-likelihood {found.predicted:+.3g} as it was fitted)"
        )
    return ""


def _unhelpful(before: Comparison, after: Comparison, settings: Settings) -> str:
    """Why an effect does no good to what is predicted; empty where it does.

    The squared error that it takes away, over what is left, is a size in standard deviations of
    the noise; the largest over the horizons and the free run of the fitted records counts.
    """
    forces = max(random_forces(after).values(), default=0.0)
    if forces > _OWN:
        return (
            f"with it, too, a random force of {100 * forces:.3g} % of the machine's own would have "
            "to act: the model has not found its values, or is of another machine"
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
    found = finished(own, pruned(own, found, progress), progress)
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
        if any(abs(values.get(k, 0.0)) > 3 * errors.get(k, np.inf) for k in keys):
            continue
        trial = refitted(assembly, let_go(assembly, found.state, (label,)))
        if trial.height > found.height - price(len(keys), trial.estimate.prepared):
            found = trial
            gone.append(assembly.variant(label).original.label)
    return found, tuple(gone)


def _settle(assembly: Assembly, step: Step, progress: Progress) -> Settled:
    return step.found.settled


def _ranked(step: Step) -> tuple[Suggestion, ...]:
    scored: Scored = step.found
    label = next(iter(step.admitted), "")
    found = _suggestions(scored.rivals, scored.ranking, label, step.aliases.get(label, ()))
    return tuple(sorted(found, key=lambda s: -(s.net or 0.0)))  # one order, whatever is proposed


def _choose(assembly: Assembly, state: FitState, step: Step, label: str) -> Step:
    """Another candidate in place of the proposal; no gate is asked."""
    scored: Scored = step.found
    assembly = having(assembly, state.labels)
    rival = next((r for r in scored.rivals if r.label == label), None)
    if rival is None:
        base = refitted(assembly, state, steps=_WARM, rough=True)
        rival = refit_alone(assembly, base, _of(scored.ranking, label))
    settled = _with(rival.assembly, rival.fit.state, rival.ranked.variant.label, silent)
    effect = next(v.original for v in assembly.offered if v.original.label == label)
    group = set(step.admitted) | {x for v in step.aliases.values() for x in v}
    aliases = tuple(sorted(group - {label})) if label in group else ()
    return replace(
        step, suggestions=_ranked(step)[:_LISTED], admitted=(label,), aliases={label: aliases},
        second_order=second_order(effect, assembly, state), meaning=effect.meaning(),
        found=replace(scored, settled=settled),
    )  # fmt: skip


def _admit(assembly: Assembly, state: FitState, label: str, progress: Progress) -> Settled:
    """An effect admitted by its name, with the shapes that the record prefers."""
    assembly = having(assembly, state.labels)
    base = refitted(assembly, state, steps=_WARM, rough=True)
    progress(f"refitting with {label}")
    found = ranking(assembly, base, base.estimate.noise, None)
    if found is None:
        raise ConfigError(f"add {label}", "a model whose fit does not diverge",
                          "check units and signs of the channels")  # fmt: skip
    rival = refit_alone(assembly, base, _of(found, label))
    return _with(rival.assembly, rival.fit.state, rival.ranked.variant.label, progress)


def _of(found: Ranking, label: str) -> Ranked:
    """The best variant of an effect among those ranked."""
    for ranked in found.ranked:
        if ranked.variant.original.label == label:
            return ranked
    raise ConfigError(f"add {label}", "an effect that these records can be asked about",
                      "it is no number along them, or nothing moves at its port")  # fmt: skip


def _suggestions(
    rivals: Sequence[Rival], found: Ranking, label: str, aliases: tuple[str, ...]
) -> tuple[Suggestion, ...]:
    """The admitted one, then what was refitted by its worth, then others by their score.

    A score promises what refits do not keep; of the others, whose scores are lower, no more is said
    than what the least of those refitted explains.
    """
    listed = {s.effect: s for s in by_evidence(found, None, ())}
    tried: dict[str, Suggestion] = {}
    for rival in rivals:
        tried.setdefault(rival.label, _as_suggestion(rival, listed))
    least, net = (min((getattr(s, n) or 0.0 for s in tried.values()), default=1.0)
                  for n in ("explains", "net"))  # fmt: skip
    others = [
        replace(s, explains=min(s.explains, least), net=min(s.net or 0.0, net))
        for s in listed.values()
        if s.effect not in tried
    ]
    named = [*tried.values(), *others]
    named = [replace(s, aliases=aliases) if s.effect == label else s for s in named]
    return tuple(sorted(named, key=lambda s: s.effect != label))


def _as_suggestion(rival: Rival, listed: Mapping[str, Suggestion]) -> Suggestion:
    """A refitted candidate: twice its gain in log-likelihood, and the share of the misses."""
    from scipy import stats

    count = sum(p.misses.size for p in rival.fit.estimate.parts) / 2  # the half that selects
    gain, terms = max(rival.gain, 0.0), len(rival.ranked.columns)
    p_value = float(stats.chi2.sf(2 * gain, terms))
    return replace(
        listed[rival.label], statistic=2 * gain, p_value=p_value, wald_p_value=p_value,
        explains=1 - float(np.exp(-2 * gain / count)),
        net=1 - float(np.exp(-2 * rival.worth / count)),
    )  # fmt: skip


LIKELIHOOD = Strategy("likelihood", _begin, _propose, _settle, _ranked, _choose, _admit)
