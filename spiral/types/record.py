"""Records: measured or simulated series. The only place where input is checked and normalised."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from spiral.types.clock import MINIMUM_SAMPLES, check_forward, check_time, check_uniform
from spiral.types.errors import InputError, did_you_mean
from spiral.types.formatting import extent
from spiral.types.invalid import (
    InvalidReadings,
    bridged,
    clipping,
    invalid_words,
    spoilt_readings,
)
from spiral.types.noise import estimate_noise
from spiral.types.parameter import HELD, Input, Interpolation
from spiral.types.probing import readings_with_rates

if TYPE_CHECKING:
    from spiral.types.system import System

Array = np.ndarray


_TEST_SHARES = (0.2, 0.3, 0.4, 0.5)  # of a record's end, kept apart where none is given
_QUIET = 0.3  # share of a reading's deviation under which a part of a record hardly moves
_MOST_MISSING = 0.5  # share of a channel's readings that may be missing and left out


@dataclass(frozen=True, repr=False)
class Record:
    """One measured or simulated series on a uniform time grid.

    Parameters
    ----------
    name : where it came from, for messages and tables.
    time : (samples,) in s, uniform and increasing.
    channels : measured outputs, name -> (samples,), in the system's units.
    inputs : known inputs, name -> (samples,), in the system's units (speed in rad/s).
    noise : declared standard deviation per channel; a channel left out is estimated.
    truth : states known from simulation, hidden ones included; never used by a fit.
    measured : inputs that were measured rather than derived (``phase`` from ``speed``).
    notes : what a reader should know (conversions), in words.
    spoilt : readings that are no measurement, by channel; ``make_record`` finds them.
    hold : how an input runs between its samples, by name, where not as its system says.
    growth : channel -> (c, h, m) where its noise grows with the reading y: its variance is
        (1 + ((y - c) / h)^2) / m times that of the others.
    loudness : channel -> variance of its white noise over the mean of a study's fitted records.
    doubts : questions to who gave the record, by what they ask after (a series of which nobody said
        the unit, and which is unlikely in the system's).
    """

    name: str
    time: Array
    channels: Mapping[str, Array]
    inputs: Mapping[str, Array] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    truth: Mapping[str, Array] = field(default_factory=dict)
    measured: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    spoilt: Mapping[str, tuple[InvalidReadings, ...]] = field(default_factory=dict)
    hold: Mapping[str, Interpolation] = field(default_factory=dict)
    growth: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    loudness: Mapping[str, float] = field(default_factory=dict)
    doubts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = _as_numbers(self.name, "time", self.time)
        object.__setattr__(self, "time", time)
        for group in ("channels", "inputs"):
            given = {k: _as_numbers(self.name, k, v) for k, v in getattr(self, group).items()}
            object.__setattr__(self, group, given)
            for key, values in given.items():
                if values.shape != time.shape:
                    raise InputError(
                        f"{self.name}: {key!r} of shape {values.shape}",
                        f"a number for every time, ({len(time)},)",
                    )
        if len(time) > 1:
            check_forward(self.name, time)
            check_uniform(self.name, time)

    def __repr__(self) -> str:
        series = f"channels {', '.join(self.channels)}; inputs {', '.join(self.inputs) or 'none'}"
        return "\n  ".join(
            [f"Record {self.name}: {extent(self.samples, 1 / self.dt)}", series, *self.remarks]
        )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def dt(self) -> float:
        """Sample interval in s."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @property
    def sha256(self) -> str:
        """Hash of all numbers a fit can see."""
        digest = hashlib.sha256()
        for name, values in (("time", self.time), *self.channels.items(), *self.inputs.items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values, dtype=float).tobytes())
        return digest.hexdigest()

    def part(self, start: int, stop: int, name: str) -> Record:
        """Samples [start, stop), as a record of its own."""
        cut = slice(start, stop)
        return replace(
            self,
            name=name,
            time=self.time[cut],
            channels={k: v[cut] for k, v in self.channels.items()},
            inputs={k: v[cut] for k, v in self.inputs.items()},
            truth={k: v[cut] for k, v in self.truth.items()},
            spoilt={k: tuple(s.part(cut) for s in v) for k, v in self.spoilt.items()},
        )

    def followed_by(self, later: Record) -> Record:
        """The record and the next part of the same series, as one, with its own noise."""
        edges = ((self, (0, later.samples)), (later, (self.samples, 0)))

        def joined(one: Mapping[str, Array], other: Mapping[str, Array]) -> dict[str, Array]:
            return {k: np.concatenate([v, other[k]]) for k, v in one.items()}

        spoilt = {
            k: tuple(s.padded(*beside) for part, beside in edges for s in part.spoilt.get(k, ()))
            for k in {*self.spoilt, *later.spoilt}
        }
        return replace(
            self, time=np.concatenate([self.time, later.time]), noise=self.sigma(), truth={},
            channels=joined(self.channels, later.channels),
            inputs=joined(self.inputs, later.inputs), spoilt=spoilt,
        )  # fmt: skip

    def stretch(self, start: int, stop: int, name: str = "") -> Record:
        """Samples [start, stop), with the noise that the whole record has."""
        return replace(self.part(start, stop, name or self.name), noise=self.sigma())

    def between(self, known: Input) -> Interpolation:
        """Interpolation of an input: the record's, else the system's default."""
        return self.hold.get(known.name, known.interpolation)

    def running(self, ways: Mapping[str, Interpolation]) -> Record:
        """The record with ``ways`` as interpolation of inputs for which it states none.

        Of one that it states to be held, how late it acts may be among them.
        """
        late = {k for k, w in self.hold.items() if w == "zero_order" and ways.get(k) in HELD}
        hold = {**ways, **{k: w for k, w in self.hold.items() if k not in late}}
        if hold == self.hold:
            return self
        known, key = self._otherwise, tuple(sorted(hold.items()))
        if key not in known:
            known[key] = replace(self, hold=hold)
            known[key].__dict__["_sigma"] = self._sigma  # the readings are the same
        return known[key]

    @cached_property
    def _otherwise(self) -> dict[tuple[tuple[str, str], ...], Record]:
        """Cache of ``running``: this record under other interpolations of its inputs."""
        return {}

    def gone(self, channel: str) -> Array | None:
        """(samples,) True where a reading of a channel is invalid; ``None`` where all are valid."""
        masks = [s.where for s in self.spoilt.get(channel, ()) if s.where.any()]
        return np.logical_or.reduce(masks) if masks else None

    def without_readings(self, spikes: Mapping[str, Array]) -> Record:
        """The record with these readings, (samples,) True by channel, left out as spikes."""
        if not spikes:
            return self
        more = {k: InvalidReadings("spike", mask) for k, mask in spikes.items()}
        spoilt = {k: tuple(_merge_spikes(self.spoilt.get(k, ()), m)) for k, m in more.items()}
        return replace(self, spoilt={**self.spoilt, **spoilt})

    @property
    def spoilt_words(self) -> tuple[str, ...]:
        """In words, which readings are invalid (missing, spikes, dropouts, clipped)."""
        return invalid_words([(self.spoilt, self.samples)])

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes, doubts, and which readings are invalid."""
        return (*self.notes, *self.doubts.values(), *self.spoilt_words)

    def reading(self, channel: str) -> Array:
        """A channel, interpolated linearly where its readings are invalid."""
        gone = self.gone(channel)
        return self.channels[channel] if gone is None else bridged(self.channels[channel], gone)

    def valid_reading(self, channel: str) -> Array:
        """``reading``, or the valid ones alone where most are not, as of a sensor that is slow."""
        gone = self.gone(channel)
        if gone is None or gone.mean() < 0.5:
            return self.reading(channel)
        return self.channels[channel][~gone]

    def sigma(self) -> dict[str, float]:
        """Noise of every channel: declared, or estimated without a model."""
        return dict(self._sigma)

    @cached_property
    def _sigma(self) -> dict[str, float]:
        return {
            name: float(self.noise.get(name) or estimate_noise(self.valid_reading(name)))
            for name in self.channels
        }


def _as_numbers(record: str, key: str, values: Any) -> Array:
    """(samples,) finite numbers.

    Raises
    ------
    InputError : no series, or one with text or gaps in it.
    """
    try:
        numbers = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{record}: {key!r}: {error}", "a series of numbers") from error
    if numbers.ndim != 1:
        raise InputError(f"{record}: {key!r} of shape {numbers.shape}", "a series, (samples,)")
    if not np.all(np.isfinite(numbers)):
        row = int(np.flatnonzero(~np.isfinite(numbers))[0])
        raise InputError(
            f"{record}: {key!r} is {numbers[row]} at row {row}", "numbers in every row",
            "spiral.read of a file or a DataFrame says what may be done about it",
        )  # fmt: skip
    return numbers


def make_record(
    system: System,
    name: str,
    time: Array,
    channels: Mapping[str, Array],
    inputs: Mapping[str, Array],
    noise: Mapping[str, float] | None = None,
    truth: Mapping[str, Array] | None = None,
    notes: tuple[str, ...] = (),
    hold: Mapping[str, str] | str | None = None,
    filled: Mapping[str, Array] | None = None,
) -> Record:
    """Check a series against a system and complete its inputs.

    Readings of a channel that are NaN, at most half of them, are left out, and so are those where
    ``filled`` (name -> (samples,)) says that a value was put in the place of a reading.
    ``hold`` says how inputs run between their samples where not as the system says
    (``types.parameter.Input``), by name or for all: ``zero_order`` where a controller holds them.

    Raises
    ------
    InputError : channels or inputs missing or unknown, lengths that differ, numbers missing, time
        that does not increase or is not uniform, a constant channel, too few samples.
    """
    time = np.asarray(time, dtype=float)
    given = {k: np.asarray(v, dtype=float) for k, v in channels.items()}
    known = {k: np.asarray(v, dtype=float) for k, v in inputs.items()}
    _check_names(system, given, known)
    held = _check_hold(system, hold or {})
    check_time(name, time)
    missing = {k: _missing_mask(v) for k, v in given.items()}
    given = {k: bridged(v, missing[k]) for k, v in given.items()}
    _check_series(name, given, known, len(time))
    missing |= {k: missing[k] | where for k, where in (filled or {}).items()}
    spoilt = _find_spoilt_readings(system, given, known, missing)
    whole = [k for k, some in spoilt.items() if "clipped" not in [s.kind for s in some]]
    extra = [clipping(k, given[k]) for k in whole]
    known = integrate_derived_inputs(system, time, known)
    step = (time[-1] - time[0]) / (len(time) - 1)
    return Record(
        name=name,
        time=time[0] + step * np.arange(len(time)),
        channels={k: given[k] for k in system.observed},
        inputs={i.name: known[i.name] for i in system.inputs},
        noise=check_noise(dict(noise or {}), given),
        truth=dict(truth or {}),
        measured=tuple(inputs),
        notes=(*notes, *(note for note in extra if note)),
        spoilt={k: some for k, some in spoilt.items() if some},
        hold=held,
    )


def _merge_spikes(
    known: tuple[InvalidReadings, ...], more: InvalidReadings
) -> Iterator[InvalidReadings]:
    """Invalid readings by kind, these spikes among those that are known."""
    yield from (s for s in known if s.kind != more.kind)
    where = [s.where for s in known if s.kind == more.kind]
    yield replace(more, where=np.logical_or.reduce([more.where, *where]))


def check_fits(system: System, record: Record) -> None:
    """Refuse a record without the channels and inputs of a system.

    Raises
    ------
    InputError : what is missing, by name.
    """
    needed = {"channel": system.observed, "input": tuple(i.name for i in system.inputs)}
    for kind, known in (("channel", record.channels), ("input", record.inputs)):
        for name in needed[kind]:
            if name not in known:
                told = ", ".join(known) or "none"
                raise InputError(
                    f"{record.name}: {kind}s {told}",
                    f"{kind} {name!r} of system {system.plugin_name()!r} among them",
                    "spiral.read with that system makes records that fit it",
                )


def _find_spoilt_readings(
    system: System, given: Mapping[str, Array], known: Mapping[str, Array],
    missing: Mapping[str, Array | None],
) -> dict[str, tuple[InvalidReadings, ...]]:  # fmt: skip
    """Invalid readings of each channel; readings that may jump are not searched for spikes."""
    jumps = readings_with_rates(system)
    return {
        k: spoilt_readings(v, known.values(), missing[k], k not in jumps) for k, v in given.items()
    }


def _check_hold(system: System, hold: Mapping[str, str] | str) -> dict[str, Interpolation]:
    """How inputs run between their samples, by name; one word is for all that may be held."""
    if isinstance(hold, str):
        hold = {name: hold for port in system.driven for name in port.axes}
    inputs, checked = [i.name for i in system.inputs], {}
    for name, how in hold.items():
        if name not in inputs:
            known = ", ".join(inputs) or "none"
            told = f"an input of the system: {known}"
            raise InputError(f"hold of {name!r}", told, did_you_mean(name, inputs))
        if how not in (words := get_args(Interpolation)):
            told = f"one of {', '.join(words)}"
            raise InputError(f"hold of {name!r}: {how!r}", told, did_you_mean(how, words))
        checked[name] = how
    return checked


def usual_test_share(record: Record) -> float:
    """The share of a record's end that is kept apart where none is given: a fifth, or up to half.

    The least of a few of which the second half moves: a reading deviates there by ``_QUIET`` of
    what it does over the record. The first half may be needed to let the start settle, and a
    machine at rest tells nothing of a model. A fifth where no share does, as of a long run-down.
    """

    def moves(share: float) -> bool:
        last = round(record.samples * (1.0 - share / 2))
        return any(np.std(v[last:]) >= _QUIET * np.std(v) for v in record.channels.values())

    return next((share for share in _TEST_SHARES if moves(share)), _TEST_SHARES[0])


def split_off_test(record: Record, share: float | None = None) -> tuple[Record, Record]:
    """The first part for fitting and the last ``share`` (``usual_test_share``) for the test."""
    share = usual_test_share(record) if share is None else share
    cut = round(record.samples * (1.0 - share))
    return (
        record.part(0, cut, record.name),
        record.part(cut, record.samples, f"{record.name} (last {share:.0%}, kept apart)"),
    )


def in_blocks(record: Record, count: int) -> tuple[Record, ...]:
    """A record cut into ``count`` stretches of equal length, in order.

    Raises
    ------
    InputError : stretches of too few samples.
    """
    if count == 1:
        return (record,)
    length = record.samples // count
    if length < 4 * MINIMUM_SAMPLES:
        raise InputError(
            f"{record.name}: {record.samples} samples in {count} blocks",
            f"at least {4 * MINIMUM_SAMPLES} samples in each", "fewer blocks",
        )  # fmt: skip
    edges = [length * k for k in range(count)] + [record.samples]
    return tuple(
        record.part(first, last, f"{record.name} (block {k} of {count})")
        for k, (first, last) in enumerate(pairwise(edges), 1)
    )


def _check_names(system: System, channels: dict[str, Array], inputs: dict[str, Array]) -> None:
    name = system.plugin_name()
    for key in channels:
        if key not in system.observed:
            raise InputError(
                f"channel {key!r}",
                f"a measured channel of system {name!r}: {', '.join(system.observed)}",
                did_you_mean(key, system.observed),
            )
    for key in system.observed:
        if key not in channels:
            raise InputError(
                f"channels {', '.join(channels) or 'none'}",
                f"also {key!r}, which system {name!r} measures",
                f"name its column: record.channels='{{{key}: COLUMN}}'",
            )
    known = [i.name for i in system.inputs]
    for key in inputs:
        if key not in known:
            raise InputError(
                f"input {key!r}",
                f"an input of {name!r}: {', '.join(known)}",
                did_you_mean(key, known),
            )
    for item in system.inputs:
        if item.name not in inputs and item.derived_from is None:
            raise InputError(
                f"inputs {', '.join(inputs) or 'none'}",
                f"also {item.name!r} in {item.unit}, which drives system {name!r}",
                f"name its column: record.inputs='{{{item.name}: COLUMN}}'",
            )


def _check_series(
    name: str, channels: Mapping[str, Array], inputs: Mapping[str, Array], samples: int
) -> None:
    for kind, group in (("channel", channels), ("input", inputs)):
        for key, values in group.items():
            check_values(name, kind, key, values, samples)


def _missing_mask(values: Array) -> Array:
    """True where readings are missing; False everywhere if too many are, which is an error."""
    lacking = np.isnan(values)
    return lacking & (lacking.sum() <= _MOST_MISSING * len(values))


def check_values(name: str, kind: str, key: str, values: Array, samples: int) -> None:
    """Refuse a series of another length, with missing values, or a channel that never moves."""
    if len(values) != samples:
        raise InputError(
            f"{name}: {kind} {key!r} with {len(values)} values", f"{samples}, as many as times"
        )
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(
            f"{name}: {kind} {key!r} has {len(bad)} missing values of {len(values)}, the first at "
            f"row {bad[0]}",
            "a number in every row; of a channel half of them may be missing",
            "cut the gap out with record.rows, or give the parts as several records",
        )
    if kind == "channel" and np.ptp(values) == 0:
        raise InputError(
            f"{name}: channel {key!r} is constant ({values[0]:.6g})",
            "a signal that moves",
            "check the sensor and the column's name",
        )


def check_noise(noise: Mapping[str, float], channels: Mapping[str, Array]) -> dict[str, float]:
    """Declared noise of known channels, positive."""
    for key, value in noise.items():
        if key not in channels:
            told = f"a channel: {', '.join(channels)}"
            raise InputError(f"noise of {key!r}", told, did_you_mean(key, channels))
        if not (isinstance(value, int | float) and np.isfinite(value) and value > 0):
            raise InputError(f"noise of {key!r}: {value!r}", "a positive standard deviation")
    return {k: float(v) for k, v in noise.items()}


def integrate_derived_inputs(
    system: System, time: Array, inputs: Mapping[str, Array]
) -> dict[str, Array]:
    """Inputs (..., samples) with those that follow from others: integrals, at first zero."""
    from scipy.interpolate import CubicSpline

    completed = dict(inputs)
    for item in system.inputs:
        if item.name not in completed and item.derived_from is not None:
            source = CubicSpline(time, completed[item.derived_from], axis=-1)
            completed[item.name] = source.antiderivative()(time)
    return completed
