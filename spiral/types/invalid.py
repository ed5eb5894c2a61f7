"""Finds invalid readings: missing values, repeats, spikes, values held in a dropout, clipped ones.

Those not missing are recognised from the signal alone, and only where nothing else looks alike:

    spike    r_k = y_k - (4 (y_{k-1} + y_{k+1}) - (y_{k-2} + y_{k+2})) / 6 is above 12 robust
             standard deviations of all r, and with y_k on that cubic the two readings on each side
             are within 4: a step, a kink or a burst is not mended by one; where more of them stand
             near jumps of an input than chance puts there, those are its doing; the deviation
             is that of a converter's rounding, q / 12^(1/2), at least (``reading_step``)
    repeat   a reading that repeats the one before, of a sensor whose runs of equal values have all
             one length of two or more, or two lengths that differ by one: it samples more slowly
             than the record, and each value is told once
    dropout  readings that leave the motion for one value and come back, all for the same one: a
             jump there and one back, each above 12 of these deviations and 4 usual changes, and
             little between the readings around them
    held     a run of readings that equal the one before exactly, three at least
    clipped  readings that equal the largest or smallest exactly

The last two need a signal that hardly ever repeats a value by itself: a coarse converter does, and
so does a record without noise; in these neither is looked for. A coarse converter that a steady
motion carries from step to step has runs of one length, too: there a run is no repeat.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Array = np.ndarray

ROBUST = 1.4826  # standard deviation over the median size, of normal noise
_OUT = 12.0  # of these deviations, from which a reading stands out
_AGREE = 4.0  # how many of these the neighbours may be off once one reading is mended
_MOST = 0.05  # share of spikes beyond which they are the signal itself
_MOST_STILL = 0.3  # share of held or clipped readings beyond which they are how it moves
_RUN, _TIES = 3, 4  # fewest readings of a run; of an extreme
_STRETCH = 128  # readings over which noise of another size is told from a few spikes
_APART = 3  # readings between close spikes, at most
_FEWEST_RUNS, _REGULAR = 16, 0.95  # runs of a sensor that repeats, and share of one length
_STEPS = 3.0  # steps of a converter that values jump by where it is not the steps that last
_MULTIPLES = 8  # steps that lie between neighbouring values, at most: a fast motion leaves many out
_LEVELS = 2  # distances of values from which they are judged to be a grid
_ROUNDED = 0.05  # share of a step that rounding may take
_SLOWED = 0.2  # of the usual change of a reading, below which a motion comes to rest
_FREQUENT = 5.0  # times as often as a usual value an extreme repeats where a sensor clips
_PAIRS = np.array([(i, i + d) for d in range(1, _APART + 1) for i in range(-3, 4 - d)])
_WEIGHTS = np.array([6, -4, 1, 0]) / 6  # of a reading in the r of those so many away
_OWN = np.array([1, -4, 6, -4, 1]) / 6  # of the readings in r
_LONGEST_DROP, _DROPS = 10, 2  # readings of one dropout, and fewest of them that share a value
_CHANCE = 0.01  # probability of runs by chance, below which they are none
_NEAR_JUMPS = 0.1  # the same of so many spikes near jumps of an input, whose doing they then are
_EXTRAPOLATED = 6.0  # deviation of a cubic's extrapolation over that of r, of white noise
_GROWTH = 4.0  # of differences, from the 4th to the 8th, above which they are noise


Kind = Literal["missing", "repeat", "spike", "dropout", "held", "clipped"]


@dataclass(frozen=True)
class InvalidReadings:
    """Invalid readings of one channel, of one kind; ``where`` (samples,) is True there."""

    kind: Kind
    where: Array

    def part(self, cut: slice) -> InvalidReadings:
        """The same for a slice of the samples."""
        return InvalidReadings(self.kind, self.where[cut])

    def padded(self, before: int, after: int) -> InvalidReadings:
        """The same with so many valid readings before and after."""
        return InvalidReadings(self.kind, np.pad(self.where, (before, after)))


def invalid_words(
    records: Sequence[tuple[Mapping[str, tuple[InvalidReadings, ...]], int]],
) -> tuple[str, ...]:
    """In words, which readings are invalid, each channel and kind once.

    ``records`` : of each its invalid readings by channel, and its samples.
    """
    total = sum(samples for _, samples in records)
    counts: Counter[tuple[str, Kind]] = Counter()
    for invalid, _ in records:
        for channel, some in invalid.items():
            for one in some:
                counts[channel, one.kind] += int(one.where.sum())
    return tuple(_words(*key, n, n / total) for key, n in counts.items() if n)


def _words(channel: str, kind: Kind, count: int, share: float) -> str:
    """In words: how many readings of a channel are invalid, and why."""
    many = f"{count} reading{'s' if count > 1 else ''} ({100 * share:.2g} %)"
    one, several = {
        "missing": ("is missing", "are missing"),
        "spike": (
            "stands out from its neighbours like a spike (an outlier)",
            "stand out from their neighbours like spikes (outliers)",
        ),
        "repeat": (
            "is a repeat: the sensor samples more slowly than this record",
            "are repeats: the sensor samples more slowly than this record",
        ),
        "dropout": (
            "drops to one value and comes back, as in a dropout",
            "drop to one value and come back, as in a dropout",
        ),
        "held": (
            "repeats the one before exactly, as in a dropout",
            "repeat the one before exactly, as in a dropout",
        ),
        "clipped": (
            "rests at an extreme: the sensor clips (saturates)",
            "rest at an extreme: the sensor clips (saturates)",
        ),
    }[kind]
    left = "it is" if count == 1 else "they are"
    return f"sensor {channel}: {many} {one if count == 1 else several}; {left} left out"


def spoilt_readings(
    values: Array, inputs: Iterable[Array] = (), missing: Array | None = None, smooth: bool = True
) -> tuple[InvalidReadings, ...]:
    """Invalid readings of a channel, by kind.

    Parameters
    ----------
    values : (samples,), bridged where ``missing``; such a channel is searched for nothing else.
    inputs : (samples,) each; spikes that follow their jumps are none.
    smooth : whether the readings follow a smooth motion; those that may jump with a force are not
        searched for spikes.
    """
    if missing is not None and missing.any():
        return (InvalidReadings("missing", missing),)
    repeated = _repeat_mask(values)
    if repeated.any():
        fresh = np.flatnonzero(~repeated)
        inner = spoilt_readings(values[fresh], [given[fresh] for given in inputs], None, smooth)
        return (
            InvalidReadings("repeat", repeated),
            *(InvalidReadings(s.kind, _mask_at(fresh[s.where], len(values))) for s in inner),
        )
    spoilt = _found_by_repeats(values, smooth)
    gone = np.logical_or.reduce([np.zeros(len(values), dtype=bool), *(s.where for s in spoilt)])
    spikes = _spike_mask(bridged(values, gone)) if smooth else np.zeros(len(values), dtype=bool)
    jumps = [np.convolve(_jump_mask(given), np.ones(5), "same") > 0 for given in inputs]
    for near in [near for near in jumps if _answer_jumps(spikes, near)]:
        spikes &= ~near
    if 0 < spikes.sum() <= _MOST * len(values):
        spoilt.append(InvalidReadings("spike", spikes))
    return tuple(s for s in spoilt if s.where.any())


def _found_by_repeats(values: Array, smooth: bool) -> list[InvalidReadings]:
    """What rests at an extreme, repeats the reading before, or drops to one value."""
    spoilt: list[InvalidReadings] = []
    same = np.diff(values) == 0
    runs = _long_run_mask(same)
    step = reading_step(values) if same.any() else 0.0  # asked of nothing else
    least = _STEPS * step  # by which it leaves a value that is not its own
    clipped = _clipped_mask(values, least)  # which repeats its extreme, and nothing else
    repeats = same & ~runs & ~clipped[1:]
    by_chance = len(values) * float(np.mean(repeats)) ** _RUN  # runs where repeats are independent
    held = np.concatenate([[False], runs]) & ~clipped
    noisy = _is_noise_like(values[1:][~same])
    dropped = _dropout_mask(values, step) if smooth and noisy else np.zeros_like(held)
    moves = max(clipped.mean(), held.mean()) <= _MOST_STILL  # else it rests so by itself
    sudden = _long_run_mask(same, np.abs(np.diff(values)), least)
    held &= np.concatenate([[False], sudden])
    if by_chance < _CHANCE and moves and noisy:
        spoilt = [InvalidReadings("clipped", clipped), InvalidReadings("held", held & ~dropped)]
    spoilt.append(InvalidReadings("dropout", dropped))
    return spoilt


def reading_step(values: Array) -> float:
    """The step q of a converter whose multiples all readings are; 0 where they are no such grid.

    The distances of neighbouring values are whole multiples of it, but for the rounding of a text;
    the usual distance is one of its first few.
    """
    apart = np.diff(np.unique(values))
    if len(apart) < _LEVELS or not np.ptp(values) > 0:
        return 0.0
    usual = float(np.median(apart))
    steps = (_step_of(apart, usual / multiple) for multiple in range(1, _MULTIPLES + 1))
    return next((step for step in steps if step > 0), 0.0)


def _step_of(apart: Array, step: float) -> float:
    """The step near ``step`` of which distances are whole multiples, else 0."""
    told = apart[apart > _ROUNDED * step]
    count = np.round(told / step)
    if not count.all():
        return 0.0
    step = float(np.sum(told) / np.sum(count))
    off = np.abs(told / step - count)
    return step if np.mean(off <= _ROUNDED) >= 1 - _ROUNDED else 0.0


def bridged(values: Array, gone: Array) -> Array:
    """The channel, interpolated linearly where readings are ``gone``."""
    if not gone.any() or gone.all():
        return values
    at = np.arange(len(values))
    return np.where(gone, np.interp(at, at[~gone], values[~gone]), values)


def _repeat_mask(values: Array) -> Array:
    """Readings that repeat the one before, of a sensor that samples more slowly than the record."""
    none = np.zeros(len(values), dtype=bool)
    jumps = np.diff(values)
    new = np.flatnonzero(jumps) + 1
    if len(new) < _FEWEST_RUNS or 2 * len(new) > len(values):
        return none
    runs = np.diff(new)
    usual = int(np.bincount(runs).argmax())
    regular = max(
        np.mean(np.isin(runs, lengths)) for lengths in ((usual - 1, usual), (usual, usual + 1))
    )
    whole = runs % usual == 0  # two values in a row may be equal by chance
    if usual < 2 or max(regular * (usual > 2), np.mean(whole)) < _REGULAR:
        return none
    if np.median(np.abs(jumps[new - 1])) < _STEPS * reading_step(values):
        return none
    repeated = ~none
    repeated[new] = repeated[0] = False
    if np.mean(whole) >= _REGULAR:
        repeated[new[0] % usual :: usual] = False
    return repeated


def _mask_at(places: Array, count: int) -> Array:
    """(count,) True at these places."""
    mask = np.zeros(count, dtype=bool)
    mask[places] = True
    return mask


def _runs(mask: Array) -> Array:
    """(runs, 2) where each run of True begins, and the place after its end."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges).reshape(-1, 2)


def _long_run_mask(same: Array, jumps: Array | None = None, least: float = 0.0) -> Array:
    """Where a repeated value belongs to a run of at least ``_RUN``.

    With ``jumps``, to one that the readings leave by ``least``: they do not where a slow motion
    stays on one step of a converter.
    """
    mask = np.zeros(len(same), dtype=bool)
    for first, last in _runs(same):
        left = jumps is None or last == len(same) or jumps[last] >= least
        if last - first >= _RUN and left:
            mask[first:last] = True
    return mask


def _is_noise_like(values: Array) -> bool:
    """Whether high differences grow as those of noise do (13.6 times from the 4th to the 8th).

    Those of a signal that is sampled well enough to be seen shrink.
    """
    if len(values) < 16:
        return False
    fourth, eighth = (float(np.median(np.abs(np.diff(values, k)))) for k in (4, 8))
    return eighth > _GROWTH * fourth


def clipping(key: str, values: Array) -> str:
    """A note where a channel rests at its extremes for many samples in a row."""
    extreme = [at[1:] & at[:-1] for at in _at_extremes(values)]
    extreme = [e if _is_reached_in_motion(e, values) else np.zeros_like(e) for e in extreme]
    share, elsewhere = float(np.mean(extreme[0] | extreme[1])), np.diff(values) == 0
    elsewhere &= ~(extreme[0] | extreme[1])
    levels = len(np.unique(values))  # a coarse converter repeats each of them
    if share > 1e-3 and share * levels > _FREQUENT * float(np.mean(elsewhere)):
        return f"channel {key!r} looks clipped: {share:.1%} of its samples rest at an extreme"
    return ""


def _is_reached_in_motion(rests: Array, values: Array) -> bool:
    """Whether a channel comes to its extreme, and leaves it, at a speed; more than once.

    A machine that comes to rest there slows down before. ``rests`` (samples - 1,) is True between
    two readings at the extreme.
    """
    span = float(np.ptp(values))
    usual = span * np.sqrt(np.mean((np.diff(values)[~rests] / span) ** 2))
    return len(_runs(rests)) > 1 and np.median(_jumps_beside(rests, values)) > _SLOWED * usual


def _jumps_beside(rests: Array, values: Array) -> Array:
    """Sizes of the last change before each run of rests, and of the first one after it."""
    jumps = np.abs(np.diff(values))
    beside = [k for first, last in _runs(rests) for k in (first - 1, last) if 0 <= k < len(jumps)]
    return jumps[beside] if beside else np.zeros(1)


def _clipped_mask(values: Array, least: float) -> Array:
    """Readings at an extreme that it rests at, and comes to or leaves by jumps of ``least``."""
    mask = np.zeros(len(values), dtype=bool)
    for at in _at_extremes(values):
        rests = at[1:] & at[:-1]
        if at.sum() >= _TIES and rests.any() and np.median(_jumps_beside(rests, values)) >= least:
            mask |= at
    return mask


def _at_extremes(values: Array) -> tuple[Array, Array]:
    """Where a channel is at its largest, and at its smallest."""
    near = 1e-9 * np.ptp(values)
    return np.abs(values - values.max()) <= near, np.abs(values - values.min()) <= near


def _spike_mask(values: Array) -> Array:
    """Single readings whose neighbours agree without them; the farthest off are corrected first.

    Then pairs at most three readings apart, as two spikes may happen to be; not where more
    than half as many places are still off as there were single spikes: those are pulses of the
    signal.
    """
    spikes = np.zeros(len(values), dtype=bool)
    if len(values) < 16:
        return spikes
    y = values.copy()
    rounding = float(np.sqrt(np.sum(_OWN**2) / 12)) * reading_step(y)
    scale = np.maximum(ROBUST * _usual_sizes(cubic_residual(y)), rounding)
    last = np.ones(1)
    while last.any() and spikes.sum() <= _MOST * len(y):
        last = np.zeros(len(y), dtype=bool)
        off = cubic_residual(y)
        for k in _candidate_spikes(off, spikes, scale):
            last[k] = _spike_sizes(y, [k], scale) is not None
        y[last] -= off[last]
        spikes |= last
    met = _candidate_spikes(cubic_residual(y), spikes, scale)
    places = 1 + np.count_nonzero(np.diff(met) > _APART) if met else 0
    for k in met if 2 * places <= spikes.sum() else ():
        trials = ((pair, _spike_sizes(y, pair, scale)) for pair in _PAIRS + k)
        pair, amounts = next((t for t in trials if t[1] is not None), (np.zeros(0, int), 0.0))
        y[pair] -= amounts
        spikes[pair] = True
    return spikes | _edge_spike_mask(y, scale)


def _dropout_mask(values: Array, step: float) -> Array:
    """Short runs of one value far from the motion, which begin and end with a jump.

    step : that of a converter (``reading_step``).
    """
    jumps = np.diff(values)
    noise, change = (ROBUST * float(np.median(np.abs(x)))
                     for x in (cubic_residual(values)[2:-2], jumps))  # fmt: skip
    edges = np.flatnonzero(
        np.abs(jumps) > max(_OUT * max(noise, step / np.sqrt(12)), _AGREE * change)
    )
    first, last = edges[:-1] + 1, edges[1:] + 1
    there, back = jumps[edges[:-1]], jumps[edges[1:]]
    moved = np.cumsum(jumps != 0)  # up to each jump
    still = (last - first <= _LONGEST_DROP) & (moved[last - 2] == moved[first - 1])
    least = np.minimum(np.abs(there), np.abs(back))
    around = np.maximum(0.5 * least, _AGREE * change * (last - first + 1))
    runs = np.flatnonzero(still & (there * back < 0) & (np.abs(there + back) < around))
    _, which, counts = np.unique(values[first[runs]], return_inverse=True, return_counts=True)
    dropped = np.zeros(len(values), dtype=bool)
    for k in runs[counts[which] >= _DROPS]:
        dropped[first[k] : last[k]] = True
    return dropped if dropped.sum() <= _MOST * len(values) else np.zeros_like(dropped)


def _usual_sizes(residual: Array) -> Array:
    """(samples,) median size of a residual over the record, or of the stretch around where larger.

    Noise may grow with its reading: where it is loud a reading of its own kind is no spike.
    """
    size = np.abs(residual[2:-2])
    stretches = np.array_split(size, max(len(size) // _STRETCH, 1))
    medians = [float(np.median(part)) for part in stretches]
    ends = np.cumsum([len(part) for part in stretches])
    centres = ends - 0.5 * np.array([len(part) for part in stretches]) + 2
    around = np.interp(np.arange(len(residual)), centres, medians)
    return np.maximum(around, float(np.median(size)))


def _edge_spike_mask(values: Array, scale: Array) -> Array:
    """Single readings among the four at either end that are far off the cubic through those inside.

    There no two neighbours on each side say what a reading should be. To do without one of them by
    mistake is harmless; where most of them are off, the signal moves so.
    """
    spikes = np.zeros(len(values), dtype=bool)
    exact = 1e-9 * float(np.ptp(values))
    if not scale.min() > exact:  # without noise a step at an end is no less sharp
        return spikes
    y = values.copy()
    for z, mask, usual in ((y, spikes, scale), (y[::-1], spikes[::-1], scale[::-1])):
        for k in range(len(z) - 4, len(z)):
            expected = 4 * z[k - 1] - 6 * z[k - 2] + 4 * z[k - 3] - z[k - 4]
            if abs(z[k] - expected) > _OUT * _EXTRAPOLATED * usual[k]:
                z[k], mask[k] = expected, True
        if mask[-4:].sum() > 1:
            mask[-4:] = False
    return spikes


def _candidate_spikes(off: Array, spikes: Array, scale: Array) -> list[int]:
    """Readings far from the cubic through their neighbours, farther than the two on each side."""
    far = np.flatnonzero((np.abs(off) > _OUT * scale) & ~spikes)
    return [int(k) for k in far if np.abs(off[k]) >= np.abs(off[max(k - 2, 0) : k + 3]).max()]


def _spike_sizes(values: Array, at: Sequence[int], scale: Array) -> Array | None:
    """How far the readings ``at`` are from the cubics through their neighbours.

    None where the neighbours do not agree without them, or where one of them is not far off itself.
    """
    low, high = int(min(at)), int(max(at))
    if low < 4 or high >= len(values) - 4:
        return None
    around = values[low - 4 : high + 5].copy()
    places = np.asarray(at) - (low - 4)
    apart = np.abs(np.subtract.outer(places, places))
    amounts = np.linalg.solve(_WEIGHTS[apart], cubic_residual(around)[places])
    around[places] -= amounts
    near = {p + d for p in places for d in (-2, -1, 1, 2)} - set(places)
    left = np.abs(cubic_residual(around))[sorted(near)]
    # another spike four readings on leaves one neighbour off
    usual = float(np.max(scale[np.asarray(at)]))
    agree = np.sum(left > _AGREE * usual) <= 1 and np.median(left) <= _AGREE * usual
    return amounts if agree and np.all(np.abs(amounts) > _OUT * usual) else None


def cubic_residual(values: Array) -> Array:
    """r, how far a reading is from a cubic through two neighbours on each side; 0 at the ends."""
    residual = np.zeros(len(values))
    inner = 4 * (values[1:-3] + values[3:-1]) - (values[:-4] + values[4:])
    residual[2:-2] = values[2:-2] - inner / 6
    return residual


def _answer_jumps(spikes: Array, near: Array) -> bool:
    """Whether more spikes stand near jumps of an input than chance puts there.

    Those of a sensor fall anywhere: k of n readings near a jump, at the rate p of all others, by
    the binomial distribution. What an input kicks follows it.
    """
    from scipy import special

    count, there = int(np.sum(spikes & near)), int(near.sum())
    rate = (float(np.sum(spikes & ~near)) + 1.0) / (len(near) - there + 1.0)
    return count > 0 and float(special.bdtrc(count - 1, there, min(rate, 1.0))) < _NEAR_JUMPS


def _jump_mask(values: Array) -> Array:
    """Where an input jumps: a second difference far above its usual ones."""
    second = np.abs(np.diff(values, 2))
    usual = float(np.median(second))
    jumps = np.zeros(len(values), dtype=bool)
    jumps[1:-1] = second > _OUT * usual + 1e-9 * float(np.ptp(values))
    return jumps
