"""Effects with states of their own, proposed from the spectrum of what a fit leaves.

A resonance or a lag has a frequency that means nothing while its amplitude is zero, and among the
candidates a blind grid would need hundreds of copies. So what a fit of the standing model leaves is
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
from spiral.engine.score import tabulate
from spiral.engine.sensitivities import reduce, residuals
from spiral.engine.statistics import paired_errors, whiteness
from spiral.engine.study import Point
from spiral.inference.evidence.admission import Admitted
from spiral.inference.evidence.assembly import Assembly, Variant, columns
from spiral.inference.evidence.fit_state import FitState, Masks, grown, stage_lengths
from spiral.inference.evidence.judge import held_out
from spiral.inference.evidence.scoring import group_of, scored, tested_keys
from spiral.inference.evidence.spectrum import frequencies, others_of, peaks, spectral, step
from spiral.inference.problem import Progress
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose
from spiral.inference.unknown.holding import carried, held_variants, reassembled, variant_of
from spiral.types.effect import Effect, SensorEffect
from spiral.types.label import split_variant
from spiral.types.record import Array

VALUES = 3  # peaks whose frequencies are tried
_FINE = np.linspace(-0.9, 0.9, 13)  # refinement of a peak, in steps


def remembered(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    proposal: Proposal,
    white: bool,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
) -> Proposal:
    """A round's proposal, with candidates that have states of their own where it calls for them.

    It is in terms of the study ``wide`` if one of them is admitted, else the proposal as it was.
    """
    waiting = called_for(options, assembly, standing, proposal, white)
    if not waiting:
        return proposal
    progress("resolving what is left into resonances and lags")
    assert proposal.evidence is not None
    wide, _ = widened(assembly, standing, proposal.evidence.stage, waiting)
    found = propose(options, wide, carried(standing, assembly, wide), masks, round_number, progress)
    if found.admitted is None or not found.admitted.variant.original.states:
        return proposal
    progress(f"following {found.admitted.variant.original.label} over the whole records")
    if not _outlasts(assembly, standing, proposal, wide, found, masks):
        return proposal
    return replace(found, wide=wide)


def _outlasts(
    assembly: Assembly,
    standing: FitState,
    proposal: Proposal,
    wide: Assembly,
    found: Proposal,
    masks: tuple[Masks, Masks],
) -> bool:
    """Whether an effect with own states still predicts best where no window ends.

    States of its own begin anew in each window, at values of the fit's choice. On windows shorter
    than its memory they imitate whatever is missing there, one sinusoid to a window; over whole
    records its motion has to follow from itself. It is compared there on held-out blocks with what
    an effect without memory makes of them (or the model as it was).
    """
    assert found.admitted is not None
    assert found.evidence is not None
    plain = standing if proposal.admitted is None else proposal.admitted.standing
    base = _over_whole(assembly, plain, masks, found.admitted.stage.length)
    late = _over_whole(wide, found.admitted.standing, masks, found.admitted.stage.length)
    paired = paired_errors(base, late, found.evidence.block)
    return paired.p_fall < assembly.problem.settings.level


def _over_whole(
    assembly: Assembly, standing: FitState, masks: tuple[Masks, Masks], length: int
) -> tuple[Array, ...]:
    """Held-out residuals on the longest windows, after a refit that grows from this length."""
    lengths = [n for n in stage_lengths(assembly) if n >= length]
    *_, last = grown(assembly, standing, masks[0], lengths, patient=True)
    return held_out(assembly, standing.labels, last, masks[1])[1]


def called_for(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    proposal: Proposal,
    white: bool,
) -> tuple[Effect, ...]:
    """Candidates with states of their own that a round tries; none while others explain the rest.

    They are tried where no other candidate passes and what is left is not white, and where the one
    that passes explains less than ``memory_share`` of what is left beyond the noise, or is a
    sensor's (a reading that comes late and a force that comes late look much the same) and leaves
    no white noise after its refit.
    """
    present = {split_variant(label)[0] for label in standing.labels}
    waiting = tuple(e for e in assembly.later if e.label not in present)
    if proposal.evidence is None or not waiting:
        return ()
    if proposal.admitted is None:
        return () if white else waiting
    label, table = proposal.admitted.variant.original.label, proposal.evidence.table
    lead = next(r for r in proposal.evidence.ranked if r.variant.original.label == label)
    if isinstance(lead.variant.original, SensorEffect):
        return () if _leaves_noise(assembly, proposal.admitted) else waiting
    return waiting if lead.score.gain < options.memory_share * (table.rest - table.dof) else ()


def _leaves_noise(assembly: Assembly, admitted: Admitted) -> bool:
    """Whether the refit of an admission leaves white noise on the samples that selected it."""
    settings = assembly.problem.settings
    stage = admitted.stage
    left = residuals(assembly.study, stage.layouts, stage.fitted.point)
    return whiteness(left, settings.lags).p >= settings.whiteness_level


@dataclass(frozen=True)
class Scanned:
    """The spectrum of what is left as one effect resolves it: Hz, and the shares explained."""

    effect: Effect
    frequency: Array
    share: Array
    variants: tuple[Variant, ...]


def widened(
    assembly: Assembly, standing: FitState, stage: Stage, effects: Sequence[Effect]
) -> tuple[Assembly, tuple[Scanned, ...]]:
    """The study with variants of effects that have states of their own, beside its candidates."""
    scans = scanned(assembly, standing, stage, effects)
    more = tuple(v for s in scans for v in s.variants)
    own = held_variants(assembly, standing.labels)
    candidates = tuple(dict.fromkeys((*assembly.problem.candidates, *effects)))
    return reassembled(assembly, candidates, (*own, *more)), scans


def scanned(
    assembly: Assembly, standing: FitState, stage: Stage, effects: Sequence[Effect]
) -> tuple[Scanned, ...]:
    """Lay the shapes of effects at the peaks of what a fit of the standing model leaves."""
    longest = max(assembly.study.series, key=lambda s: s.samples)
    return tuple(
        _scan(_Scan.of(assembly, standing, stage, e), frequencies(e, longest)) for e in effects
    )


@dataclass(frozen=True)
class _Scan:
    """One effect's copies compiled beside a standing model, to be scored along its fit."""

    effect: Effect
    copies: tuple[Variant, ...]
    wide: Assembly
    standing: FitState
    stage: Stage
    states: tuple[str, ...]

    @classmethod
    def of(cls, assembly: Assembly, standing: FitState, stage: Stage, effect: Effect) -> _Scan:
        """Compile without the other candidates."""
        copies = tuple(variant_of(effect, str(i + 1), {}) for i in range(VALUES))
        active = {split_variant(label)[0] for label in standing.labels}
        kept = [e for e in assembly.problem.candidates if e.label in active]
        own = held_variants(assembly, standing.labels)
        wide = reassembled(assembly, (*kept, effect), (*own, *copies))
        standing = replace(standing, values=stage.fitted.point.values)
        states = assembly.study.compiled.traced.states
        return cls(effect, copies, wide, carried(standing, assembly, wide), stage, states)

    def shares(self, trials: Sequence[Mapping[str, float]]) -> Array:
        """Share of what is left that each trial (shapes by name) explains."""
        found: list[float] = []
        for first in range(0, len(trials), VALUES):
            batch = trials[first : first + VALUES]
            filled = [batch[min(i, len(batch) - 1)] for i in range(VALUES)]
            found += self._batch(filled)[: len(batch)]
        return np.array(found)

    def _batch(self, trials: Sequence[Mapping[str, float]]) -> list[float]:
        study, values = self.wide.study, self.standing.values.copy()
        for copy, trial in zip(self.copies, trials, strict=True):
            for name, value in trial.items():
                values[:, study.index(f"{copy.label}.{name}")] = value
        keys = self.standing.keys(self.wide)
        groups = [group_of(self.wide, copy) for copy in self.copies]
        tested = (k for copy in self.copies for k in tested_keys(self.wide, copy))
        moving, _ = columns(self.wide, (*keys, *tested))
        point = Point(values, self._starts(values))
        reduction = reduce(study, self.stage.layouts, point, moving)
        if not reduction.finite:
            return [0.0] * len(trials)
        table = tabulate(reduction, columns(self.wide, keys)[0].count)
        return [found.explains for _, found in scored(table, groups)]

    def _starts(self, values: Array) -> tuple[Array, ...]:
        """The fit's own states where its windows begin, those of the copies driven to there."""
        names = self.wide.study.compiled.traced.states
        at = [names.index(n) for n in self.states]
        found = first_starts(self.wide.study, self.stage.layouts, values)
        for mine, fitted in zip(found, self.stage.fitted.point.starts, strict=True):
            mine[:, at] = fitted
        return found


def _scan(scan: _Scan, band: Array) -> Scanned:
    """The spectrum, and variants at its refined peaks: first the frequency, then the others."""
    effect = scan.effect
    usual, others = others_of(effect)
    share = scan.shares([{**usual, **spectral(effect, f)} for f in band])
    chosen = []
    for peak in peaks(share)[:VALUES]:
        near = band[peak] * step(effect) ** _FINE
        best = near[np.argmax(scan.shares([{**usual, **spectral(effect, f)} for f in near]))]
        trials = [{**o, **spectral(effect, best)} for o in others]
        chosen.append(trials[int(np.argmax(scan.shares(trials)))])
    searched = max(len(band) // len(chosen), 1)
    variants = tuple(variant_of(effect, str(i + 1), c, searched) for i, c in enumerate(chosen))
    return Scanned(effect, band, share, variants)
