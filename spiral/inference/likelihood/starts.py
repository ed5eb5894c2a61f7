"""The seed fitted from several starts; the likelihood of the whole records decides.

1. the values given, or the balance of forces through the measured motion (``fit_state.begin``),
   hidden states from zero, and once more with those of first order from where they rest;
2. a fit on windows of 64 and 256 samples, which bears values that are far off where the motion is
   measured;
3. the first again with process noise ten times smaller and ten times larger to begin with;
4. where values of the best have run away, those held as they were given, and then let go;
5. where noise turns out to be of another kind, or what is left is not white, the first again with
   the noise that is known by then;
6. where what is left is not white still, the best so far with all of that taken for sensor noise.

Each is taken a few steps, and the most likely one to its maximum. The next is tried only while the
best so far does not explain the records (its fit did not converge, or it needs a random force that
is no small one) and no two of them agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from spiral.engine.filter.task import at_rest
from spiral.engine.likelihood.noise import NoiseModel, first_noise
from spiral.engine.likelihood.predict import all_predicted
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import last_stage
from spiral.inference.evidence.fit_state import FitState, all_samples, stage_lengths
from spiral.inference.likelihood.beginnings import restarted
from spiral.inference.likelihood.fitting import (
    LEVEL,
    MOST_SUBSTEPS,
    WORTH,
    LikelihoodFit,
    explains,
    finer,
    is_white,
    moving,
    refitted,
    samples_of,
    subjects,
)
from spiral.inference.likelihood.ladder import climbed_ladder, pruned
from spiral.inference.problem import Progress

_HEAT = 8  # scoring steps of each start
_SAME = 0.02  # log-likelihood a reading up to which two starts have led to one place
_WINDOWS = 2  # window lengths of a start from windows
_SHOWN = 0.1  # standard errors by which steps of half the length may move an estimate
_AWAY = 100.0  # factor by which a fitted value differs from the one given that has run away
_QUIET = 1e-3  # level of a random force that does next to nothing


def best_fit(assembly: Assembly, state: FitState, progress: Progress) -> LikelihoodFit:
    """The fit of the most likely start, on steps as fine as its motion asks for."""
    best: LikelihoodFit | None = None
    for begin, level in _starts(assembly, state, progress):
        noise = first_noise(subjects(assembly, begin)[0][0], level)
        found = refitted(assembly, begin, noise, steps=_HEAT, rough=True)
        agrees = best is not None and abs(found.height - best.height) < _SAME * samples_of(
            found.estimate.prepared
        )
        if best is None or found.height > best.height:
            best = found
        if agrees or (best.estimate.converged and explains(best)):
            break
    assert best is not None
    fits = [best, *_with_runaways_held(assembly, state, best, progress)]
    best = max(fits, key=lambda f: f.height)
    progress("most likely values of the model as it is")
    found = on_finer_steps(assembly, refitted(assembly, best.state, rough=True))
    return restarted(assembly, found)


def _with_runaways_held(
    assembly: Assembly, state: FitState, found: LikelihoodFit, progress: Progress
) -> list[LikelihoodFit]:
    """The fit of a start in which no value runs away; none where none has.

    A value far beyond what was given (a heat capacity without end) has no slope left there, and
    others make up for it. It is held as given while the others find theirs, and then let go.
    """
    known, index = assembly.problem.model.values, assembly.study.index
    keys = [k for k in moving(assembly, found.state) if known.get(k)]
    shares = {k: float(found.state.values[0, index(k)]) / known[k] for k in keys}
    lost = tuple(k for k, x in shares.items() if not 1 / _AWAY <= x <= _AWAY)
    if not lost:
        return []
    progress("starting again with values held that have run away")
    holding = replace(state, held=(*state.held, *lost))
    noise = first_noise(subjects(assembly, holding)[0][0], LEVEL)
    first = refitted(assembly, holding, noise, rough=True)
    if not first.estimate.finite:
        return []
    free = replace(first.state, held=state.held)
    return [refitted(assembly, free, noise, rough=True)]


def rebalanced(assembly: Assembly, found: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """The fit begun again with all that it misses taken for sensor noise, if that is better.

    Noise of a sensor and a random force on what it measures look alike over few samples: a fit may
    end where one of them does the work of the other, and what is left is then not white. Noise that
    is not white looks like motion, so the ladder is climbed from there as well.
    """
    if not found.estimate.finite or is_white(assembly, found):
        return found
    progress("starting again with sensor noise alone")
    again = refitted(assembly, found.state, sensors_alone(found), rough=True)
    if not is_white(assembly, again):
        again = climbed_ladder(assembly, again, progress)
    return again if again.height > found.height else found


def with_values_given(assembly: Assembly, state: FitState) -> FitState | None:
    """The state with what moves as the model was given; nothing where nobody gave a value."""
    known = assembly.problem.model.values
    keys = [k for k in moving(assembly, state) if np.isfinite(known.get(k, np.nan))]
    values = state.values.copy()
    for key in keys:
        values[:, assembly.study.index(key)] = known[key]
    return replace(state, values=values, starts=None, spreads=None) if keys else None


def from_values_given(
    assembly: Assembly, found: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit begun again from the values given, with the noise that is known by now, if better.

    While noise of a kind that nobody knows yet (a sensor that drifts) looks like motion, values may
    go where they explain it (an absorber that does not move) and do not come back by themselves.
    Its forces are as they are by now, and as a first start has them; the ladder is climbed from the
    likelier end. Nothing is tried where the model explains the records beside white noise.
    """
    at = found.estimate
    usual = all(term.kind in ("white", "force") for term in at.noise.terms)
    given = with_values_given(assembly, found.state)
    if not at.finite or given is None or (usual and explains(found) and is_white(assembly, found)):
        return found
    progress("starting again from the values given, with the noise that is known by now")
    first = first_noise(at.prepared[0][0], LEVEL)
    noises = (at.noise, at.noise.with_values(first.values))
    fits = [refitted(assembly, given, noise, rough=True, like=at.prepared) for noise in noises]
    again = max(fits, key=lambda f: f.height)
    again = climbed_ladder(assembly, again, progress)
    if not again.height > found.height + WORTH:
        return found
    return pruned(assembly, restarted(assembly, again), progress)


def sensors_alone(found: LikelihoodFit) -> NoiseModel:
    """Noise of the sensors as large as what the model misses where no reading corrects it much."""
    prepared = found.estimate.prepared
    deaf = first_noise(prepared[0][0], _QUIET, prepared[0][0].series.y.std(axis=0))
    parts = all_predicted([(prepared, deaf)])[0]
    seen = parts if all(p.whole for p in parts) else found.estimate.parts
    misses = np.concatenate([p.misses for p in seen])
    return first_noise(prepared[0][0], _QUIET, np.sqrt(np.mean(misses**2, axis=0)))


def on_finer_steps(assembly: Assembly, found: LikelihoodFit) -> LikelihoodFit:
    """The fit again where its motion asks for finer integration steps than it had."""
    if not found.estimate.finite:
        return found
    wanted = finer(found)
    if wanted <= found.estimate.prepared[0][0].series.substeps:
        return found
    finer_state = replace(found.state, substeps=wanted)
    again = refitted(assembly, finer_state, rough=True)
    if not again.estimate.finite:  # sizes of its noise may mean something else: on the same scales
        again = refitted(assembly, finer_state, rough=True, like=found.estimate.prepared)
    return again if again.estimate.finite else found


def resolved_in_time(assembly: Assembly, found: LikelihoodFit) -> LikelihoodFit:
    """The fit on integration steps whose error no parameter shows.

    Steps of half the length change the whitened misses by d, and with them the estimates by
    V X^T d, X the misses' slopes and V the inverse of their information; where that is a share of a
    standard error that counts, the fit goes on with the shorter ones.
    """
    while found.estimate.finite and found.estimate.keys:
        at, keys, solved = found.estimate, found.estimate.keys, found.estimate.solved
        steps = 2 * at.prepared[0][0].series.substeps
        if solved is None or steps > MOST_SUBSTEPS:
            break
        state = replace(found.state, substeps=steps)
        finer_ones = subjects(assembly, state)
        trial = all_predicted([(finer_ones, at.noise)])[0]
        if not all(p.whole for p in trial):
            break
        inverse = solved.inverse[: len(keys)]
        pulled = sum(
            (np.einsum("kjp,kj->p", p.columns, (t.misses - p.misses) * p.weight)
             for p, t in zip(at.parts, trial, strict=True)), np.zeros(len(keys)),
        )  # fmt: skip
        moved = np.abs(inverse @ (inverse.T @ pulled)) / np.array(list(at.errors.values()))
        if not np.max(moved) > _SHOWN:
            break
        again = refitted(assembly, state, at.noise)
        if not again.estimate.finite:
            break
        found = again
    return found


def _starts(
    assembly: Assembly, state: FitState, progress: Progress
) -> Iterator[tuple[FitState, float]]:
    progress("starting from the values given")
    yield state, LEVEL
    rests = [at_rest(task) for task, _ in subjects(assembly, state)]
    if all(x is not None for x in rests):
        progress("starting again from hidden states that rest")
        starts = tuple(x for x in rests if x is not None)
        yield replace(state, starts=starts, spreads=None), LEVEL
    progress("starting again from short windows")
    near = _from_windows(assembly, state)
    if near is not None:
        yield near, LEVEL
    for factor in (0.1, 10.0):
        progress("starting again with another random force")
        yield state, LEVEL * factor


def _from_windows(assembly: Assembly, state: FitState) -> FitState | None:
    lengths = [n for n in stage_lengths(assembly) if n >= state.shortest][:_WINDOWS]
    stage = last_stage(assembly, state, all_samples(assembly), lengths)
    values = stage.fitted.point.values
    if not np.all(np.isfinite(values)):
        return None
    return replace(state, values=values)
