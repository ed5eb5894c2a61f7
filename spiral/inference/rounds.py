"""One round of a study in two steps: rank what may be missing, then admit a candidate.

``discover`` goes on until nothing passes the gates and admits what the strategy proposes; a person
may go on by hand and admit another candidate. Both go through these functions.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from spiral.inference.advice import advice_for
from spiral.inference.evidence.assembly import Assembly, to_model
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.identifiability.undetermined import tied_groups
from spiral.inference.problem import Problem, Progress, Settings
from spiral.inference.strategies.base import RefittedModel, StartedStudy, Step, Strategy
from spiral.inference.verdict import missing_effects, study_summary, study_verdict
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.horizon import changes
from spiral.types.model import Model
from spiral.types.run import Round, Run, StopReason, Suggestion, Verdict


@dataclass(frozen=True)
class Checkpoint:
    """All that a study needs to go on: the rounds so far and where the study stands."""

    rounds: tuple[Round, ...]
    fit_state: FitState


def strategy_for(problem: Problem) -> Strategy:
    """The problem's strategy, checked.

    Raises
    ------
    ConfigError : a problem without a strategy.
    """
    if not isinstance(problem.strategy, Strategy):
        raise ConfigError(
            f"a problem with the strategy {problem.strategy!r}",
            "a plugin of the kind strategy",
            'registry.make("strategy", "likelihood")',
        )
    return problem.strategy


def start_study(begun: StartedStudy, seconds: float) -> Checkpoint:
    """The checkpoint of a study that has only fitted its seed, which is round 0."""
    first = Round(0, (), {}, {}, (), begun.comparison, seconds, details=begun.details)
    return Checkpoint((first,), begun.fit_state)


def rank_last_round(
    strategy: Strategy, assembly: Assembly, at: Checkpoint, progress: Progress
) -> tuple[Checkpoint, Step]:
    """The last round with its candidates ranked, and what the strategy would admit next."""
    last, fit_state = at.rounds[-1], at.fit_state
    step = strategy.propose(assembly, fit_state, last.comparison, len(at.rounds), progress)
    if step.again is not None:
        fit_state, details = step.again.fit_state, {**last.details, **step.again.details}
        last = replace(
            last, comparison=step.again.comparison, details=details,
            retired=(*last.retired, *step.again.retired),
        )  # fmt: skip
    ranked = replace(
        last,
        suggestions=step.suggestions,
        rejected={**assembly.left_out, **step.rejected},
        left_out=dict(assembly.left_out),
        details={**last.details, **step.details},
    )
    at = Checkpoint((*at.rounds[:-1], ranked), fit_state)
    return (
        (at, step)
        if step.admitted
        else _recheck_look_alikes(strategy, assembly, at, step, progress)
    )


def _recheck_look_alikes(
    strategy: Strategy, assembly: Assembly, at: Checkpoint, step: Step, progress: Progress
) -> tuple[Checkpoint, Step]:
    """Look-alikes asked again on the final model; a likelier one replaces its effect.

    The details of a round keep those that were dropped as ``told_apart``; the step returned puts
    a likelier look-alike in the place of its effect, where there is one.
    """
    *earlier, last = at.rounds
    held = last.comparison.model.labels
    asked = {
        label: tuple(x for x in others if x not in held)
        for r in earlier for label, others in r.aliases.items() if label in held
    }  # fmt: skip
    if not any(r.admitted for r in at.rounds):
        return at, step
    promising = _promising_candidates(at.rounds)
    again = strategy.ask_again(assembly, at.fit_state, last.comparison, asked, promising, progress)
    rounds = tuple(_with_look_alikes(r, asked, again.aliases) for r in earlier)
    latest = dict.fromkeys((x for x in last.aliases if x in held), ())  # new ones alone
    rounds = (*rounds, _with_look_alikes(last, latest, again.aliases))
    return Checkpoint(rounds, at.fit_state), again.step or step


def _promising_candidates(rounds: Sequence[Round]) -> dict[str, tuple[Suggestion, ...]]:
    """By effect of the final model, itself and others with a net gain when it was admitted."""
    held = rounds[-1].comparison.model.labels
    return {
        label: tuple(s for s in before.suggestions
                     if (s.effect == label or s.effect not in held) and (s.net or 0.0) > 0)
        for before, after in itertools.pairwise(rounds) for label in after.admitted
        if label in held
    }  # fmt: skip


def _with_look_alikes(
    one: Round, asked: Mapping[str, tuple[str, ...]], left: Mapping[str, tuple[str, ...]]
) -> Round:
    """A round with the look-alikes that the final model leaves: fewer, or one more.

    A twin whose fit was held up while another effect was missing comes to light only here.
    """
    admitted = {k: v for k, v in one.aliases.items() if k in asked}
    gone = {k: [x for x in asked[k] if x not in left.get(k, ())] for k in admitted}
    new = {k: tuple(x for x in left.get(k, ()) if x not in v) for k, v in admitted.items()}
    gone = {label: others for label, others in gone.items() if others}
    if not gone and not any(new.values()):
        return one
    aliases = {
        k: (*(x for x in v if x not in gone.get(k, ())), *new.get(k, ()))
        for k, v in one.aliases.items()
    }
    details = {**one.details, "told_apart": gone} if gone else one.details
    return replace(one, aliases=aliases, details=details)


def choose_candidate(
    strategy: Strategy, assembly: Assembly, at: Checkpoint, step: Step, label: str
) -> Step:
    """The step with a candidate of a person's choice in place of the strategy's own.

    Raises
    ------
    ConfigError : no such candidate, or a strategy whose own proposal alone can be admitted.
    """
    if label in step.admitted:
        return step
    known = [s.effect for s in strategy.ranked(step)]
    if not strategy.by_hand or label not in known:
        raise ConfigError(
            f"add {label}", f"one of {', '.join(known) or 'none'}", did_you_mean(label, known)
        )
    return strategy.choose(assembly, at.fit_state, step, label)


def admit_step(
    strategy: Strategy,
    assembly: Assembly,
    at: Checkpoint,
    step: Step,
    progress: Progress,
    spent: float = 0.0,
) -> Checkpoint:
    """The study after one more round: the step's effects admitted, refitted and compared.

    ``strategy=likelihood`` has refitted already in ``propose`` and only hands the result over here.

    ``spent`` : seconds that finding them has taken.
    """
    clock = time.perf_counter()
    settled = strategy.settle(assembly, step, progress)
    seconds = spent + time.perf_counter() - clock
    return Checkpoint((*at.rounds, _round_after(at.rounds[-1], step, settled, seconds)),
                      settled.fit_state)  # fmt: skip


def _round_after(before: Round, step: Step, settled: RefittedModel, seconds: float) -> Round:
    return Round(
        number=before.number + 1,
        admitted=step.admitted,
        aliases=dict(step.aliases),
        rejected={},
        suggestions=(),
        comparison=settled.comparison,
        seconds=seconds,
        second_order=step.second_order,
        meaning=step.meaning,
        retired=settled.retired,
        details=settled.details,
        changes=changes(before.comparison.unseen, settled.comparison.unseen),
    )


def conclude_study(
    at: Checkpoint, stopped: StopReason, settings: Settings, advice: str | None = None
) -> Run:
    """The ``Run`` of a study that ends at this checkpoint: verdict, advice, rounds, final model."""
    rounds = at.rounds
    verdict = study_verdict(rounds, stopped, settings)
    groups = tied_groups(rounds[0].details, rounds[-1].details)
    if verdict == "not_identifiable":
        stopped = "not_identifiable"
    said = advice_for(verdict, stopped, rounds, (), settings) if advice is None else advice
    return Run(
        verdict,
        stopped,
        rounds,
        rounds[-1].comparison.model,
        said,
        groups,
        missing=missing_effects(rounds, settings),
        summary=study_summary(rounds, verdict, stopped, settings),
    )


def refuse_study(begun: StartedStudy, first: Round) -> Run:
    """The ``Run`` of a study that ends at once: its record cannot tell the seed's effects apart."""
    fit_state = begun.fit_state
    model: Model = to_model(begun.assembly, fit_state.labels, fit_state.values, {})
    verdict: Verdict = "not_identifiable"
    settings = begun.assembly.problem.settings
    return Run(
        verdict, "not_identifiable", (first,), model,
        advice_for(verdict, "not_identifiable", [first], begun.groups, settings), begun.groups,
        summary=study_summary([first], verdict, "not_identifiable", settings),
    )  # fmt: skip
