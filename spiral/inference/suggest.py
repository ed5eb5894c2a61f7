"""Suggestions of ``strategy=shooting``: scores on growing windows, gates, alias groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import special

from spiral.engine.growth import Stage
from spiral.engine.score import cosine
from spiral.engine.statistics import PairedDifference, paired_errors, round_level
from spiral.inference.evidence.admission import AdmittedEffect, admit_candidate
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState, Masks, fit_growing_windows
from spiral.inference.evidence.free_run import fit_held_out
from spiral.inference.evidence.refit_scores import rescore_from_far_starts
from spiral.inference.evidence.scoring import Evidence, RankedCandidate, Ranking, score_stage
from spiral.inference.problem import Progress, Settings, silent
from spiral.inference.strategy_options import ShootingOptions
from spiral.types.effect import SensorEffect
from spiral.types.run import Suggestion

_TWIN, _TWIN_SHARE = 0.999, 0.99  # cosine and share of the gain from which two are one
_NEAR = 5  # of the first, among which alike signatures are hinted at: a pair costs a cosine
_HINT = 0.95  # cosine of two signatures from which the hint is given
_STAGES = 4  # looks at the data, over which the level is shared


@dataclass(frozen=True)
class Proposal:
    """What one round found: evidence, the candidate to admit with its aliases, refusals.

    ``dropped`` are effects of earlier rounds that the admission starts without. ``wide`` is the
    study in which candidates with states of their own were scored too, where a round called for
    them; evidence and admission then are in its terms.
    """

    evidence: Evidence | None
    stages: tuple[Stage, ...]
    admitted: AdmittedEffect | None
    aliases: tuple[str, ...]
    suggestions: tuple[Suggestion, ...]
    rejected: Mapping[str, str] = field(default_factory=dict)
    dropped: tuple[str, ...] = ()
    wide: Assembly | None = None

    @property
    def not_separable(self) -> Mapping[str, tuple[str, ...]]:
        """Candidates that the model's own parameters can take over, in part or whole, and whose."""
        if self.evidence is None:
            return {}
        tied = {r.variant.original.label: r.tied for r in self.evidence.ranked if r.tied}
        return dict(sorted(tied.items()))

    @property
    def diverged(self) -> bool:
        """Whether not even the shortest windows could be fitted."""
        return self.evidence is None


def propose_on_windows(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress = silent,
) -> Proposal:
    """One round's evidence on the selecting half, judged on the other half.

    Parameters
    ----------
    masks : (select, judge) for every record.
    round_number : from 1; decides the share of the study's error rate that is spent.
    """
    settings = assembly.problem.settings
    evidence, stages = _score_growing_windows(
        options, assembly, fit_state, masks[0], round_number, progress
    )
    if evidence is None:
        return Proposal(None, stages, None, (), ())
    rejected: dict[str, str] = {}
    chosen: AdmittedEffect | None = None
    aliases: tuple[str, ...] = ()
    tests = _test_count(assembly, evidence)
    passing = [r for r in evidence.ranked if _is_significant(r, tests, settings, round_number)]
    for ranked in passing[: options.rivals + 1]:
        if ranked.variant.original.label in rejected:
            continue
        progress(f"refitting with {ranked.variant.original.label} and its rivals")
        first, aliases = _refit_rivals(
            options, assembly, fit_state, evidence, ranked, passing, masks[1], rejected
        )
        reason = _refusal_reason(assembly, fit_state, evidence, first, masks[1])
        if not reason:
            chosen = first
            break
        rejected[first.variant.original.label] = reason
    shown = top_suggestions(options, evidence, chosen, aliases)
    return Proposal(evidence, stages, chosen, aliases, shown, rejected)


def _score_growing_windows(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    mask: Masks,
    round_number: int,
    progress: Progress,
) -> tuple[Evidence | None, tuple[Stage, ...]]:
    """Score at growing windows; keep the longest whose fit converged and whose leaders agree."""
    settings = assembly.problem.settings
    kept: Evidence | None = None
    stages: list[Stage] = []
    for stage in fit_growing_windows(assembly, fit_state, mask):
        stages.append(stage)
        if not np.isfinite(stage.fitted.cost) or (kept is not None and not stage.fitted.converged):
            break
        progress(f"scoring candidates on windows of {stage.length} samples")
        evidence = rescore_from_far_starts(
            assembly, fit_state, score_stage(assembly, fit_state, stage)
        )
        tests = _test_count(assembly, evidence)
        if kept is not None and not _leaders_agree(
            options, kept, evidence, tests, settings, round_number
        ):
            break
        kept = evidence
    return kept, tuple(stages)


def _leading_labels(
    options: ShootingOptions, evidence: Evidence, tests: int, settings: Settings, round_number: int
) -> list[str]:
    """The significant ones of the top three that come near the first (as rivals do)."""
    top = evidence.ranked[:3]
    return [
        r.variant.original.label
        for r in top
        if _is_significant(r, tests, settings, round_number)
        and r.score.gain >= options.rival_share * top[0].score.gain
    ]


def _leaders_agree(
    options: ShootingOptions, before: Evidence, after: Evidence, tests: int, settings: Settings,
    round_number: int,
) -> bool:  # fmt: skip
    """Whether longer windows keep the first suggestion and lose none of its near rivals.

    Where nothing was significant before, or where the model is nearly right on the longer windows
    (so that they cannot have led it into a wrong basin), the first suggestion alone must stay.
    """
    old = _leading_labels(options, before, tests, settings, round_number)
    new = _leading_labels(options, after, tests, settings, round_number)
    if not old:
        return True
    nearly_right = after.stage.fitted.chi2_per_dof < settings.chi2_limit
    kept = old[0] in new[:1] or (bool(new) and old[0] in _twin_labels(after))
    return kept and (nearly_right or set(old) <= set(new))


def _twin_labels(evidence: Evidence) -> list[str]:
    """Those of the top three whose signatures and gains are the first one's: either may lead."""
    first, *others = evidence.ranked[:3]
    return [
        r.variant.original.label
        for r in others
        if r.score.gain >= _TWIN_SHARE * first.score.gain
        and cosine(evidence.table, first.columns, r.columns) > _TWIN
    ]


def _test_count(assembly: Assembly, evidence: Evidence) -> int:
    """Tests of a round: its candidates, and those that it may call for later, at every stage."""
    names = {r.variant.original.label for r in evidence.ranked}
    waiting = sum(e.label not in names for e in assembly.later)
    return (len(evidence.ranked) + waiting) * _STAGES


def _is_significant(
    ranked: RankedCandidate, tests: int, settings: Settings, round_number: int
) -> bool:
    """Classical and robust p-values below the candidate's share of the round's level."""
    level = np.log(round_level(settings.level, round_number) / tests)
    return max(ranked.log_p) < level


def _refit_rivals(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    evidence: Evidence,
    ranked: RankedCandidate,
    passing: list[RankedCandidate],
    mask: Masks,
    rejected: Mapping[str, str],
) -> tuple[AdmittedEffect, tuple[str, ...]]:
    """Refit candidate and rivals; the best on held-out data wins, its equals are aliases."""
    gain = ranked.score.gain
    rivals = [
        r
        for r in passing
        if r.score.gain >= options.rival_share * gain and r.variant.original.label not in rejected
    ]
    rivals = sorted(rivals, key=lambda r: r is not ranked)[: options.rivals + 1]
    refits = [admit_candidate(assembly, fit_state, evidence.stage, r) for r in rivals]
    errors = [fit_held_out(assembly, a.fit_state.labels, a.stage, mask)[1] for a in refits]
    winner = 0
    for i in range(1, len(refits)):
        if paired_errors(errors[winner], errors[i], evidence.block).p_fall < _alias_level(assembly):
            winner = i

    def is_alike(i: int) -> bool:
        return _is_alike(assembly, paired_errors(errors[winner], errors[i], evidence.block))

    equals = [i for i in range(len(refits)) if i != winner and is_alike(i)]
    if _acts_on_sensor(refits[winner]):  # a change of the machine goes before one of a sensor
        machine = next((i for i in equals if not _acts_on_sensor(refits[i])), winner)
        equals, winner = [winner, *(i for i in equals if i != machine)], machine
        equals = [i for i in equals if i != winner]
    return refits[winner], tuple(refits[i].variant.original.label for i in equals)


def _acts_on_sensor(admitted: AdmittedEffect) -> bool:
    return isinstance(admitted.variant.original, SensorEffect)


def _alias_level(assembly: Assembly) -> float:
    return assembly.problem.settings.alias_level


def _is_alike(assembly: Assembly, paired: PairedDifference) -> bool:
    """Not significantly different, or so near that no draw of the noise could tell them apart.

    Twins differ by what their fits left to converge, of which a paired test may make anything.
    """
    level = _alias_level(assembly)
    return paired.p_differ >= level or paired.energy < 4 * float(special.ndtri(level / 2)) ** 2


def _refusal_reason(
    assembly: Assembly, fit_state: FitState, evidence: Evidence, first: AdmittedEffect, mask: Masks
) -> str:
    """Why the gates refuse a refitted candidate; empty where they let it pass."""
    settings = assembly.problem.settings
    fitted = first.stage.fitted
    if not np.isfinite(fitted.cost):
        return "the refitted model diverges"
    gain = max(evidence.stage.fitted.cost - fitted.cost, 0.0)
    size = float(np.sqrt(gain / fitted.samples))
    if size < settings.smallest:
        return (
            f"significant, but too small to matter: it changes the prediction by {size:.2g} noise "
            f"standard deviations (least {settings.smallest:g})"
        )
    before = fit_held_out(assembly, fit_state.labels, evidence.stage, mask)[1]
    after = fit_held_out(assembly, first.fit_state.labels, first.stage, mask)[1]
    paired = paired_errors(before, after, evidence.block)
    if paired.p_fall >= settings.level:
        fall = "no significant fall of the error on held-out blocks"
        return f"rolled back: {fall} (p = {paired.p_fall:.2g})"
    return ""


def top_suggestions(
    options: ShootingOptions,
    evidence: Evidence,
    chosen: AdmittedEffect | None,
    aliases: tuple[str, ...],
) -> tuple[Suggestion, ...]:
    """The best candidates as suggestions: the admitted one, then the others by their evidence."""
    suggestions = suggestions_by_evidence(evidence, chosen, aliases)
    label = None if chosen is None else chosen.variant.original.label
    return tuple(sorted(suggestions, key=lambda s: s.effect != label)[: options.listed])


def suggestions_by_evidence(
    evidence: Ranking, chosen: AdmittedEffect | None, aliases: tuple[str, ...]
) -> tuple[Suggestion, ...]:
    """All candidates as suggestions in one order: by ``net``, on the same windows for all.

    Whether one of them was admitted does not move it: that is judged on other samples.
    """
    order = sorted(evidence.ranked, key=lambda r: r.rank)
    label = None if chosen is None else chosen.variant.original.label
    near = [r for i, r in enumerate(order) if i < _NEAR or r.variant.original.label == label]
    suggestions = []
    for ranked in order:
        hint = tuple(
            r.variant.original.label
            for r in near
            if r is not ranked and cosine(evidence.table, ranked.columns, r.columns) > _HINT
        )
        is_first = ranked.variant.original.label == label
        net = 1.0 - float(np.exp(ranked.rank / evidence.table.samples))
        suggestions.append(_make_suggestion(ranked, aliases if is_first else (), hint, net))
    return tuple(suggestions)


def _make_suggestion(
    ranked: RankedCandidate, aliases: tuple[str, ...], hint: tuple[str, ...], net: float
) -> Suggestion:
    scored = ranked.score
    return Suggestion(
        effect=ranked.variant.original.label,
        meaning=ranked.variant.original.meaning(),
        aliases=aliases,
        p_value=float(np.exp(ranked.log_p[0])),
        statistic=scored.statistic,
        wald_p_value=float(np.exp(ranked.log_p[1])),
        explains=scored.explains,
        net=net,
        hint=hint,
    )
