"""Backward step: drop an effect admitted earlier that a later one has made superfluous.

Where look-alikes of the later one would make more superfluous than it does, the best of them is
admitted in its place: a turned probe pair is a cross stiffness and a cross damping, so it explains
alone what, once a cross stiffness came first, a cross damping explains beside it.
"""

from __future__ import annotations

from dataclasses import replace

from scipy import special

from spiral.engine.growth import Stage
from spiral.engine.statistics import paired_errors
from spiral.inference.evidence.admission import AdmittedEffect, admit_candidate, drop_effect, refit
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import fitted_model
from spiral.inference.evidence.fit_state import FitState, Masks
from spiral.inference.evidence.free_run import fit_held_out
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, top_suggestions
from spiral.types.model import Model


def superfluous_labels(
    assembly: Assembly, latest: AdmittedEffect, model: Model, mask: Masks, block: int
) -> tuple[str, ...]:
    """Compiled labels of admitted effects whose absence does not cost held-out accuracy.

    Questioned are effects (not the seed's, not the latest) none of whose amplitudes is significant
    at the study's level (1 %, shared by them) in the refitted model; each is let go where the model
    without it, refitted on the windows of the latest admission, is not significantly worse on the
    half that did not select.
    """
    gone: list[str] = []
    level = assembly.problem.settings.level
    current = latest.fit_state
    kept = fit_held_out(assembly, current.labels, latest.stage, mask)[1]
    for label in latest.fit_state.labels:
        if label in assembly.problem.model.labels or label == latest.variant.label:
            continue
        if not _is_insignificant(model, assembly.variant(label).original.label, level):
            continue
        smaller = drop_effect(assembly, current, label)
        trial = refit(assembly, smaller, latest.stage)
        stage = Stage(latest.stage.length, latest.stage.layouts, trial)
        left = fit_held_out(assembly, smaller.labels, stage, mask)[1]
        if paired_errors(left, kept, block).p_fall >= level:
            gone.append(label)
            current = replace(smaller, values=trial.point.values)
    return tuple(gone)


def prefer_simplest_alias(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    proposal: Proposal,
    mask: Masks,
) -> Proposal:
    """The proposal with the member of its alias group beside which the fewest effects are needed.

    Aliases stay those that need as few.
    """
    first, evidence = proposal.admitted, proposal.evidence
    news = [x for x in fit_state.labels if x not in assembly.problem.model.labels]
    if first is None or evidence is None or proposal.wide or not proposal.aliases or not news:
        return proposal
    ranked = {r.variant.original.label: r for r in evidence.ranked}
    others = (
        admit_candidate(assembly, fit_state, evidence.stage, ranked[x]) for x in proposal.aliases
    )
    gone = []
    for one in (group := [first, *others]):
        model = fitted_model(assembly, one.fit_state, one.stage)
        gone.append(len(superfluous_labels(assembly, one, model, mask, evidence.block)))
    best = [a for a, count in zip(group, gone, strict=True) if count == max(gone)]
    aliases = tuple(a.variant.original.label for a in best[1:])
    shown = top_suggestions(options, evidence, best[0], aliases)
    return replace(proposal, admitted=best[0], aliases=aliases, suggestions=shown)


def _is_insignificant(model: Model, label: str, level: float) -> bool:
    names = {p.name for e in model.effects if e.label == label for p in e.amplitudes()}
    rows = model.estimates()[label]
    tested = [e for n, e in rows.items() if any(n == k or n.startswith(f"{k}_") for k in names)]
    largest = -special.ndtri(level / (2 * max(len(tested), 1)))
    return bool(tested) and all(e.t is not None and abs(e.t) < largest for e in tested)
