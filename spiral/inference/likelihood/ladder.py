"""Which model of what is random the record wants: terms tried one at a time, kept by likelihood.

From white measurement noise and a white random force upwards: coloured measurement noise, noise
behind a low-pass, a sensor that drifts, a force with a correlation time. A term is kept where

    2 (log L_1 - log L_0) > q log N + 2 log(1 / alpha)

q its sizes and times, N the readings (Schwarz's criterion, with odds of 1 / alpha to one); the best
is taken first, until none is worth its price. Later, terms that are no longer worth theirs go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from spiral.engine.filter.noise import groups
from spiral.engine.filter.setup import prepared as filter_prepared
from spiral.engine.filter.task import Task, task_with
from spiral.engine.likelihood.fit import Maximum, maximise
from spiral.engine.likelihood.noise import STEEPEST, NoiseModel, NoiseTerm, limits
from spiral.engine.likelihood.predict import Prepared
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.horizons import doubts, liveliest
from spiral.inference.likelihood.fitting import (
    LEAST,
    LikelihoodFit,
    is_white,
    price,
    taken_on,
)
from spiral.inference.problem import Progress
from spiral.types.noise import COLOURED, Kind
from spiral.types.spoilt import bridged

ODDS = 100.0  # to one, for which a term is kept
_LOOK, _TUNE = 2, 10  # scoring steps of a first look at a term, and of those that keep up
_KEEP = 0.7  # share of the best gain at first look that keeps up
_SHARED = 0.7  # of the size of white noise, that it and a coloured one start with (half of it)
_ROUNDS = 2
_SEGMENT, _SHORT = 512, 32  # samples of a piece of a spectrum, at most and at least
_STANDS_OUT = 4.0  # times the median power from which a line may be one
_OWN_LINE = (
    0.25  # share of a reading's power at a line, half of its amplitude, that is missed there
)
_GUST, _GUST_TIMES = 0.05, (0.003, 0.03)  # sizes of a gust to begin with; times, of the record
_MOST_APART = 6  # states of a group whose forces are told apart: each costs slopes of its own
_NARROW = 0.1  # damping ratio that a line begins with


@dataclass(frozen=True)
class Rung:
    """Terms that come together, with sizes to start from: their own, and of others beside them."""

    terms: tuple[NoiseTerm, ...]
    values: dict[str, float]


class _Look(NamedTuple):
    """A term after its first steps: what it gains beyond its price, the noise with it, its kind."""

    gain: float
    noise: NoiseModel
    kind: Kind


def climbed_ladder(assembly: Assembly, found: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """The fit with the noise that its record wants, parameters and sizes refitted together.

    Nothing is tried where the misses are white.
    """
    if not found.estimate.finite:
        return found
    for _ in range(_ROUNDS):
        if is_white(assembly, found):
            break
        progress("trying what may act at random")
        best = _best(found.estimate)
        if best is None:
            break
        found = taken_on(assembly, found, best.noise, rough=True)
    if found.estimate.finite and not is_white(assembly, found):
        apart = _worthy(found.estimate, list(_apart(found.estimate)))
        found = found if apart is None else taken_on(assembly, found, apart.noise, rough=True)
    return _located(assembly, found)


def _located(assembly: Assembly, found: LikelihoodFit) -> LikelihoodFit:
    """The fit with a force on one state in place of its group, or with a memory, if likelier.

    What disturbs one coordinate, or lasts, leaves misses that are white, or nearly, with a white
    force of one size on all of its group too; but then it is no smaller and no other force, and
    candidates are judged beside noise that is not there. It is taken by the same odds. Where
    misses are not white ``_apart`` has been asked.
    """
    for _ in range(_ROUNDS):
        at = found.estimate
        if not at.finite or not is_white(assembly, found):
            break
        best = _worthy(at, list(_elsewhere(at)))
        if best is None:
            break
        found = taken_on(assembly, found, best.noise, rough=True)
    return found


def _elsewhere(at: Maximum) -> Iterator[NoiseModel]:
    """The noise with a force on one state of a group, or one with a memory, in place of a force."""
    task, noise = at.prepared[0][0], at.noise
    shared = shared_groups(task)
    for term in (t for t in noise.terms if t.kind in ("force", "gust")):
        size = noise.values[term.size]
        if not size > LEAST * limits(task, term.size)[0]:
            continue
        others = noise.of(t for t in noise.terms if t is not term)
        states = [task.states[i] for i in shared.get(term.where, ())]
        times = {k: v for k, v in noise.values.items() if k == term.time}
        for one in (replace(term, where=state) for state in states):
            yield others.added((one,), {**times, one.size: size})
        if term.kind == "gust" or noise.has("gust"):
            continue
        for one in (NoiseTerm("gust", where) for where in (term.where, *states)):
            yield others.added(
                (one,), {one.size: size, one.time: _first_time(task, _GUST_TIMES[0])}
            )


def shared_groups(task: Task) -> dict[str, tuple[int, ...]]:
    """States of the groups that have several, of which a force may be on one."""
    return {n: s for n, s in groups(task).items() if 2 <= len(s) <= _MOST_APART}


def _apart(at: Maximum) -> Iterator[NoiseModel]:
    """The noise with a force on each state, in place of, or beside, one for a group of states.

    What disturbs one coordinate of several (a gust on the cabin, not on the drive) leaves coloured
    misses of all where they share one size, and is not worth a size for all where it acts on one.
    """
    task, noise = at.prepared[0][0], at.noise
    shared = shared_groups(task)
    for term in noise.terms:
        if term.kind not in ("force", "gust") or term.where not in shared:
            continue
        size, each = noise.values[term.size], tuple(
            replace(term, where=task.states[i]) for i in shared[term.where]
        )  # fmt: skip
        if size > LEAST * limits(task, term.size)[0]:
            others = noise.of(t for t in noise.terms if t is not term)
            kept = {k: v for k, v in noise.values.items() if k != term.size}
            yield others.added(each, kept | {t.size: size for t in each})
    for state in (task.states[i] for s in shared.values() for i in s if not noise.has("gust")):
        one = NoiseTerm("gust", state)
        yield noise.added((one,), {one.size: _GUST, one.time: _first_time(task, _GUST_TIMES[0])})


def _first_time(task: Task, share: float) -> float:
    """A correlation time to begin with, as a share of the record; three samples at least."""
    return max(share * task.series.dt * task.series.samples, 3 * task.series.dt)


def _best(at: Maximum) -> Maximum | None:
    """The noise with one term more that is worth most beyond its price; none where none is.

    Terms are looked at on the part of the records that moves most; what keeps up there is judged on
    all, and where noise of a sensor leads its other kinds are, too: few steps do not tell a line
    from a steep low-pass. Where none of it is worth its price the best force with a memory is, too:
    it begins beside a white one that already does its work, and a few steps do not tell what it is
    worth.
    """
    part = _part(at)
    now = maximise(part, (), at.noise, steps=_LOOK)
    looks = []
    for rung in (*rungs(now), *_ringing(now)):
        noise = now.noise.added(rung.terms, rung.values)
        look = maximise(part, (), noise, steps=_LOOK)
        gain = look.log_likelihood - _price(noise, at.noise, part) - now.log_likelihood
        looks.append(_Look(gain, look.noise, rung.terms[0].kind))
    best = max(looks, key=lambda x: x.gain, default=None)
    if best is None:
        return None
    kept = [
        x.noise for x in looks
        if x.gain > 0 and (x.gain >= _KEEP * best.gain or {x.kind, best.kind} <= {*COLOURED})
    ]  # fmt: skip
    if (chosen := _worthy(at, kept)) is not None or at.noise.has("gust"):
        return chosen
    gust = max((x for x in looks if x.kind == "gust"), key=lambda x: x.gain).noise
    return None if gust in kept else _worthy(at, [gust])


def _worthy(at: Maximum, noises: Sequence[NoiseModel]) -> Maximum | None:
    """Of several models of the noise, tuned on all records, the one that is worth most."""
    best = [_steepened(tuned(at.prepared, noise)) for noise in noises]
    worths = [
        (t.log_likelihood - at.log_likelihood - _price(t.noise, at.noise, at.prepared), t)
        for t in best
        if t.finite
    ]
    worth, chosen = max(worths, key=lambda x: x[0], default=(0.0, None))
    return chosen if worth > np.log(ODDS) else None


def tuned(prepared: Prepared, noise: NoiseModel) -> Maximum:
    """The noise alone, a few steps on the whole records."""
    return maximise(prepared, (), noise, steps=_TUNE, rough=True)


def _steepened(at: Maximum) -> Maximum:
    """The noise with a low-pass of as high an order as the record wants; the same without one.

    Anti-alias filters are of fourth to eighth order. Behind one every further order makes the next
    sample much more certain, which a random force would explain otherwise.
    """
    while at.finite and (band := [t for t in at.noise.terms if t.kind == "band"]):
        order = band[0].order + 2
        if order > STEEPEST:
            break
        terms = tuple(replace(t, order=order) if t in band else t for t in at.noise.terms)
        more = tuned(at.prepared, replace(at.noise, terms=terms))
        if not (more.finite and more.log_likelihood > at.log_likelihood + np.log(ODDS)):
            break
        at = more
    return at


def _part(at: Maximum) -> Prepared:
    """The liveliest stretch of the records, at the values of an estimate."""
    r, start, stop = liveliest([task.series for task, _ in at.prepared])
    task, settings = at.prepared[r]
    if start == 0 and stop == task.series.samples:
        return (at.prepared[r],)
    record = replace(
        task.series.record.part(start, stop, task.series.record.name),
        noise=task.series.record.sigma(),
    )
    short = task_with(
        task.model, task.compiled, task.values.copy(), record, substeps=task.series.substeps
    )
    short = replace(short, moved=task.moved)
    return (filter_prepared(short, settings.tracked, doubts(settings.tracked)),)


def quieted(assembly: Assembly, found: LikelihoodFit) -> LikelihoodFit:
    """The fit without random forces that are not worth their price.

    Of a machine that nothing disturbs half the records would have some by chance, and standard
    errors that are too large with it.
    """
    noise, task = found.estimate.noise, found.estimate.prepared[0][0]
    least = {
        t.size: limits(task, t.size)[0]
        for t in noise.terms
        if t.kind == "force" and noise.values[t.size] > LEAST * limits(task, t.size)[0]
    }
    if not found.estimate.finite or not least:
        return found
    enough = found.height - price(len(least), found.estimate.prepared)
    trial = taken_on(assembly, found, noise.with_values(least), rough=True, least=enough)
    return trial if trial.height > enough else found


def _price(noise: NoiseModel, before: NoiseModel, prepared: Prepared) -> float:
    return price(len(noise.names) - len(before.names), prepared)


def rungs(now: Maximum) -> Iterator[Rung]:
    """What may come next.

    Noise of a sensor that a random force has made superfluous begins with half of what is missed.
    """
    task, noise = now.prepared[0][0], now.noise
    channels, dt = task.compiled.traced.channels, task.series.dt
    missed = np.sqrt(np.mean(now.parts[0].misses ** 2, axis=0))
    white = {
        c: max(noise.values[f"white.{c}"], limits(task, f"white.{c}")[0], 0.5 * float(m))
        for c, m in zip(channels, missed, strict=True)
    }
    spread = dict(zip(channels, np.std(task.series.y, axis=0), strict=True))
    if not noise.has("coloured") and not noise.has("band"):
        kinds: tuple[tuple[Kind, float], ...] = (("coloured", 4.0), ("band", 1.0))
        for kind, steps in kinds:
            terms = tuple(NoiseTerm(kind, c) for c in channels)
            sizes = {t.size: _SHARED * white[t.where] for t in terms}
            less = {f"white.{c}": _SHARED * white[c] for c in channels}
            yield Rung(terms, sizes | less | {f"{kind}.time": steps * dt})
    for c in channels:
        term = NoiseTerm("drift", c)
        if term in noise.terms:
            continue
        length = float(np.sqrt(dt * task.series.samples))
        yield Rung((term,), {term.size: 0.1 * float(spread[c]) / length})
    if not noise.has("gust"):
        terms = tuple(NoiseTerm("gust", g) for g in groups(task))
        for values in first_gusts(task, terms):
            yield Rung(terms, values)


def first_gusts(task: Task, terms: Sequence[NoiseTerm]) -> Iterator[dict[str, float]]:
    """Sizes that forces with a memory begin with, and their correlation time, short and long."""
    for share in _GUST_TIMES:
        sizes = {t.size: _GUST for t in terms}
        yield sizes | {t.time: _first_time(task, share) for t in terms}


def _ringing(now: Maximum) -> Iterator[Rung]:
    """A narrow line of one sensor, where the spectrum of its misses stands out most.

    At a frequency at which the machine moves, misses are of the model: only a line that is mostly
    missed is the sensor's own.
    """
    from scipy.signal import welch

    if now.noise.has("vibration"):
        return
    task, part = now.prepared[0][0], now.parts[0]
    length = int(min(_SEGMENT, task.series.samples // 4))
    if length < _SHORT:
        return
    for j, channel in enumerate(task.compiled.traced.channels):
        hertz, power = welch(part.whitened[:, j], 1 / task.series.dt, nperseg=length)
        inner = slice(2, len(power) - 1)
        top = 2 + int(np.argmax(power[inner]))
        if not power[top] > _STANDS_OUT * np.median(power[inner]):
            continue
        read = bridged(task.series.y[:, j], part.spreads[:, j] == 0)
        missed, shown = (
            welch(signal, 1 / task.series.dt, nperseg=length)[1][top]
            for signal in (part.misses[:, j], read)
        )
        if not missed >= _OWN_LINE * shown:
            continue
        term = NoiseTerm("vibration", channel)
        white = now.noise.values[f"white.{channel}"]
        size = max(white, limits(task, f"white.{channel}")[0])
        time = 1 / (2 * np.pi * float(hertz[top]))
        yield Rung((term,), {term.size: size, term.time: time, term.damping: _NARROW})


def pruned(assembly: Assembly, found: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """The fit without the terms beyond white that it no longer wants."""
    noise = found.estimate.noise
    if not found.estimate.finite:
        return found
    for kind in (*COLOURED, "gust", "drift"):
        if not noise.has(kind):
            continue
        progress("asking whether less acts at random")
        less = noise.whitened(kind)
        worth = _price(noise, less, found.estimate.prepared)
        enough = found.height - worth - float(np.log(ODDS))
        trial = taken_on(assembly, found, less, rough=True, least=enough)
        if trial.height > enough:
            found, noise = trial, less
    return found
