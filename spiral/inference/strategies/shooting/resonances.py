"""Effects with states of their own, proposed from the spectrum of what a fit leaves.

A resonance or a lag has a frequency that means nothing while its amplitude is zero, and among the
candidates a blind grid would need hundreds of copies. So what a fit of the present model leaves is
resolved first, frequency by frequency, into what such an effect with that frequency would explain:

    share(f) = |P_f r|^2 / |r|^2,    r = residual less what the model's own parameters take over,

P_f the projection onto the effect's signatures at f, which are its sensitivities along the fitted
trajectories (amplitudes within their bounds). For a resonance this is the periodogram of the
residual through a resonator at f; for a lag f is its corner, 1 / (2 pi T). The largest peaks,
refined, are the values that the candidate is then scored at beside all others; as many tests as
resonators fit into the band are paid for. The residual's noise is white, as a missing force's is
not: it grows with the square of the frequency, and hid resonances above that of the machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.growth import Stage, first_starts
from spiral.engine.score import build_score_table
from spiral.engine.sensitivities import reduce_windows, residuals
from spiral.engine.statistics import paired_errors, whiteness
from spiral.engine.study import Point
from spiral.inference.evidence.admission import AdmittedEffect
from spiral.inference.evidence.assembly import Assembly, Variant, columns_with_bounds
from spiral.inference.evidence.enlarge import (
    make_variant,
    own_state_variants,
    reassemble,
    transfer_fit_state,
)
from spiral.inference.evidence.fit_state import FitState, Masks, fit_growing_windows, stage_lengths
from spiral.inference.evidence.free_run import fit_held_out
from spiral.inference.evidence.scoring import amplitude_keys, column_group, score_groups
from spiral.inference.evidence.spectrum import (
    frequency_ratio,
    frequency_shapes,
    local_maxima,
    other_shapes,
    trial_frequencies,
)
from spiral.inference.problem import Progress
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose_on_windows
from spiral.types.effect import Effect, SensorEffect
from spiral.types.label import split_variant
from spiral.types.record import Array

VALUES = 3  # peaks whose frequencies are tried
_FINE = np.linspace(-0.9, 0.9, 13)  # refinement of a peak, in steps


def propose_with_own_states(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    proposal: Proposal,
    white: bool,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
) -> Proposal:
    """A round's proposal, with candidates that have states of their own where it calls for them.

    If one of them is admitted, the proposal refers to its study ``wide``; else it is as it was.
    """
    waiting = effects_called_for(options, assembly, fit_state, proposal, white)
    if not waiting:
        return proposal
    progress("resolving what is left into resonances and lags")
    assert proposal.evidence is not None
    wide, _ = widen_study(assembly, fit_state, proposal.evidence.stage, waiting)
    wide_proposal = propose_on_windows(
        options, wide, transfer_fit_state(fit_state, assembly, wide), masks, round_number, progress
    )
    if wide_proposal.admitted is None or not wide_proposal.admitted.variant.original.states:
        return proposal
    progress(f"following {wide_proposal.admitted.variant.original.label} over the whole records")
    if not _predicts_whole_records(assembly, fit_state, proposal, wide, wide_proposal, masks):
        return proposal
    return replace(wide_proposal, wide=wide)


def _predicts_whole_records(
    assembly: Assembly,
    fit_state: FitState,
    proposal: Proposal,
    wide: Assembly,
    wide_proposal: Proposal,
    masks: tuple[Masks, Masks],
) -> bool:
    """Whether an effect with own states still predicts best where no window ends.

    States of its own begin anew in each window, at values of the fit's choice. On windows shorter
    than its memory they imitate whatever is missing there, one sinusoid to a window; over whole
    records its motion has to follow from itself. It is compared there on held-out blocks with what
    an effect without memory makes of them (or the model as it was).
    """
    assert wide_proposal.admitted is not None
    assert wide_proposal.evidence is not None
    plain = fit_state if proposal.admitted is None else proposal.admitted.fit_state
    base = _whole_record_residuals(assembly, plain, masks, wide_proposal.admitted.stage.length)
    late = _whole_record_residuals(
        wide, wide_proposal.admitted.fit_state, masks, wide_proposal.admitted.stage.length
    )
    paired = paired_errors(base, late, wide_proposal.evidence.block)
    return paired.p_fall < assembly.problem.settings.level


def _whole_record_residuals(
    assembly: Assembly, fit_state: FitState, masks: tuple[Masks, Masks], length: int
) -> tuple[Array, ...]:
    """Held-out residuals on the longest windows, after a refit that grows from this length."""
    lengths = [n for n in stage_lengths(assembly) if n >= length]
    *_, last = fit_growing_windows(assembly, fit_state, masks[0], lengths, patient=True)
    return fit_held_out(assembly, fit_state.labels, last, masks[1])[1]


def effects_called_for(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    proposal: Proposal,
    white: bool,
) -> tuple[Effect, ...]:
    """Candidates with states of their own that a round tries; none while others explain the rest.

    They are tried where no other candidate passes and what is left is not white, and where the one
    that passes explains less than ``memory_share`` of what is left beyond the noise, or is a
    sensor's (a reading that comes late and a force that comes late look much the same) and leaves
    no white noise after its refit.
    """
    present = {split_variant(label)[0] for label in fit_state.labels}
    waiting = tuple(e for e in assembly.later if e.label not in present)
    if proposal.evidence is None or not waiting:
        return ()
    if proposal.admitted is None:
        return () if white else waiting
    label, table = proposal.admitted.variant.original.label, proposal.evidence.table
    lead = next(r for r in proposal.evidence.ranked if r.variant.original.label == label)
    if isinstance(lead.variant.original, SensorEffect):
        return () if _leaves_white_noise(assembly, proposal.admitted) else waiting
    return waiting if lead.score.gain < options.memory_share * (table.rest - table.dof) else ()


def _leaves_white_noise(assembly: Assembly, admitted: AdmittedEffect) -> bool:
    """Whether the refit of an admission leaves white noise on the samples that selected it."""
    settings = assembly.problem.settings
    stage = admitted.stage
    left = residuals(assembly.study, stage.layouts, stage.fitted.point)
    return whiteness(left, settings.lags).p >= settings.whiteness_level


@dataclass(frozen=True)
class SpectrumScan:
    """Share of the residual that one effect explains, over its trial frequency in Hz."""

    effect: Effect
    frequency: Array
    share: Array
    variants: tuple[Variant, ...]


def widen_study(
    assembly: Assembly, fit_state: FitState, stage: Stage, effects: Sequence[Effect]
) -> tuple[Assembly, tuple[SpectrumScan, ...]]:
    """The study with variants of effects that have states of their own, beside its candidates."""
    scans = scan_effects(assembly, fit_state, stage, effects)
    more = tuple(v for s in scans for v in s.variants)
    own = own_state_variants(assembly, fit_state.labels)
    candidates = tuple(dict.fromkeys((*assembly.problem.candidates, *effects)))
    return reassemble(assembly, candidates, (*own, *more)), scans


def scan_effects(
    assembly: Assembly, fit_state: FitState, stage: Stage, effects: Sequence[Effect]
) -> tuple[SpectrumScan, ...]:
    """Spectra of what a fit leaves, with variants of each effect at the largest peaks."""
    longest = max(assembly.study.series, key=lambda s: s.samples)
    return tuple(
        _scan_effect(
            _EffectCopies.compile_copies(assembly, fit_state, stage, e),
            trial_frequencies(e, longest),
        )
        for e in effects
    )


@dataclass(frozen=True)
class _EffectCopies:
    """One effect's copies compiled beside the present model, to be scored along its fit."""

    effect: Effect
    copies: tuple[Variant, ...]
    wide: Assembly
    fit_state: FitState
    stage: Stage
    states: tuple[str, ...]

    @classmethod
    def compile_copies(
        cls, assembly: Assembly, fit_state: FitState, stage: Stage, effect: Effect
    ) -> _EffectCopies:
        """Compile without the other candidates."""
        copies = tuple(make_variant(effect, str(i + 1), {}) for i in range(VALUES))
        active = {split_variant(label)[0] for label in fit_state.labels}
        kept = [e for e in assembly.problem.candidates if e.label in active]
        own = own_state_variants(assembly, fit_state.labels)
        wide = reassemble(assembly, (*kept, effect), (*own, *copies))
        fit_state = replace(fit_state, values=stage.fitted.point.values)
        states = assembly.study.compiled.traced.states
        return cls(
            effect, copies, wide, transfer_fit_state(fit_state, assembly, wide), stage, states
        )

    def shares(self, trials: Sequence[Mapping[str, float]]) -> Array:
        """Share of what is left that each trial (shapes by name) explains."""
        explained: list[float] = []
        for first in range(0, len(trials), VALUES):
            batch = trials[first : first + VALUES]
            filled = [batch[min(i, len(batch) - 1)] for i in range(VALUES)]
            explained += self._batch_shares(filled)[: len(batch)]
        return np.array(explained)

    def _batch_shares(self, trials: Sequence[Mapping[str, float]]) -> list[float]:
        study, values = self.wide.study, self.fit_state.values.copy()
        for copy, trial in zip(self.copies, trials, strict=True):
            for name, value in trial.items():
                values[:, study.index(f"{copy.label}.{name}")] = value
        keys = self.fit_state.keys(self.wide)
        groups = [column_group(self.wide, copy) for copy in self.copies]
        tested = (k for copy in self.copies for k in amplitude_keys(self.wide, copy))
        moving, _ = columns_with_bounds(self.wide, (*keys, *tested))
        point = Point(values, self._window_starts(values))
        reduction = reduce_windows(study, self.stage.layouts, point, moving)
        if not reduction.finite:
            return [0.0] * len(trials)
        table = build_score_table(reduction, columns_with_bounds(self.wide, keys)[0].count)
        return [score.explains for _, score in score_groups(table, groups)]

    def _window_starts(self, values: Array) -> tuple[Array, ...]:
        """The fit's own states where its windows begin, those of the copies driven to there."""
        names = self.wide.study.compiled.traced.states
        at = [names.index(n) for n in self.states]
        starts = first_starts(self.wide.study, self.stage.layouts, values)
        for mine, fitted in zip(starts, self.stage.fitted.point.starts, strict=True):
            mine[:, at] = fitted
        return starts


def _scan_effect(scan: _EffectCopies, band: Array) -> SpectrumScan:
    """The spectrum, and variants at its refined peaks: first the frequency, then the others."""
    effect = scan.effect
    usual, others = other_shapes(effect)
    share = scan.shares([{**usual, **frequency_shapes(effect, f)} for f in band])
    chosen = []
    for peak in local_maxima(share)[:VALUES]:
        near = band[peak] * frequency_ratio(effect) ** _FINE
        best = near[
            np.argmax(scan.shares([{**usual, **frequency_shapes(effect, f)} for f in near]))
        ]
        trials = [{**o, **frequency_shapes(effect, best)} for o in others]
        chosen.append(trials[int(np.argmax(scan.shares(trials)))])
    searched = max(len(band) // len(chosen), 1)
    variants = tuple(make_variant(effect, str(i + 1), c, searched) for i, c in enumerate(chosen))
    return SpectrumScan(effect, band, share, variants)
