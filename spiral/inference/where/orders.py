"""Order analysis of a record: spectrograms, synchronous response, full spectra.

An order is a frequency over that of rotation. Where the phase is known, a series is sampled anew
at equal angles, so that an order stays one line however the speed moves (computed order tracking,
Fyfe and Munck 1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.types.record import Array

PER_TURN = 64
HIGHEST = 12.0  # orders that are shown
_TURNS = 8  # of a slice: an order is resolved to 1/8
_SLICES = 400  # at most


@dataclass(frozen=True)
class Spectrogram:
    """``power`` (slices, frequencies), one-sided, in unit^2 summed over channels.

    ``at`` (slices,) is the time in s, or the speed in rad/s; ``axis`` the frequency in Hz, or the
    order; ``weight`` (slices,) the seconds that a slice stands for.
    """

    at: Array
    axis: Array
    power: Array
    weight: Array


def time_map(
    values: Array, dt: float, length: int | None = None, count: int | None = None, finer: int = 1
) -> Spectrogram:
    """Time x frequency: Hann-windowed slices of ``values`` (samples, channels), half overlapping.

    Parameters
    ----------
    length : samples of a slice; left out, a 24th of the record, from 64 to 1024.
    count : slices spread evenly, in place of half overlapping ones.
    finer : times as many frequencies, interpolated by zeros behind each slice.
    """
    samples = len(values)
    size = length or int(np.clip(samples // 24, 64, 1024))
    size = min(size, samples)
    starts = _slice_starts(samples, size)
    if count is not None:
        starts = np.unique(np.linspace(0, samples - size, count).astype(int))
    power = np.sum([_slice_powers(v, starts, size, finer) for v in values.T], axis=0)
    every = dt * samples / len(starts)
    axis = np.fft.rfftfreq(finer * size, dt)
    return Spectrogram(dt * (starts + size / 2), axis, power, np.full(len(starts), every))


def noise_power(spectrogram: Spectrogram, dt: float, channels: int, turning: bool = False) -> Array:
    """The expected ``power`` of white noise of variance one in each channel, (slices,).

    Its one-sided density is 2 dt, and a Hann window 3/2 steps of the axis wide; over orders
    (``turning``), 2 dt f at f turns a second, at least what lies within half of ``PER_TURN``.
    """
    density = 2.0 * dt * np.ones(len(spectrogram.at))
    if turning:
        density = np.maximum(density * np.abs(spectrogram.at) / (2 * np.pi), 2.0 / PER_TURN)
    return 1.5 * channels * density * float(spectrogram.axis[1] - spectrogram.axis[0])


def order_map(values: Array, phase: Array, speed: Array, dt: float) -> Spectrogram | None:
    """Speed x order: power of ``values`` (samples, channels), resampled at equal angles.

    Nothing where the record holds fewer than four turns.
    """
    from scipy.interpolate import CubicSpline

    turned = np.maximum.accumulate(np.abs(phase - phase[0]))
    turns = float(turned[-1]) / (2 * np.pi)
    if turns < 4:
        return None
    angle = 2 * np.pi * np.arange(int(turns * PER_TURN)) / PER_TURN
    grid = np.arange(len(values), dtype=float)
    rising = np.concatenate([[True], np.diff(turned) > 0])
    at = np.interp(angle, turned[rising], grid[rising])
    size = PER_TURN * int(np.clip(turns // 6, 2, _TURNS))
    starts = _slice_starts(len(angle), size)
    turning = CubicSpline(grid, values)(at)
    power = np.sum([_slice_powers(v, starts, size) for v in turning.T], axis=0)
    orders = np.fft.rfftfreq(size, 1.0 / PER_TURN)
    shown = orders <= HIGHEST
    middle = np.minimum(starts + size // 2, len(at) - 1)
    lasting = dt * np.gradient(at)[middle] * len(at) / len(starts)
    return Spectrogram(np.interp(at[middle], grid, speed), orders[shown], power[:, shown], lasting)


def _slice_starts(samples: int, size: int) -> Array:
    step = max(size // 2, (samples - size) // _SLICES, 1)
    return np.arange(0, samples - size + 1, step)


def _slice_powers(values: Array, starts: Array, size: int, finer: int = 1) -> Array:
    """Power (slices, frequencies) of Hann-windowed slices: a sine of amplitude A gives A^2 / 2."""
    window = np.hanning(size)
    pieces = np.stack([values[s : s + size] for s in starts]) * window
    return 2.0 * np.abs(np.fft.rfft(pieces, finer * size, axis=1)) ** 2 / window.sum() ** 2


@dataclass(frozen=True)
class FirstOrder:
    """Synchronous response: ``speed`` (slices,) rad/s; ``amplitude`` (slices, channels), complex.

    A series A cos(theta - lag) has the amplitude A exp(-i lag): the phase of the number is minus
    the lag behind the rotor's mark.
    """

    speed: Array
    amplitude: Array

    @property
    def lag(self) -> Array:
        """Phase lag behind the mark in degrees, (slices, channels), continuous over speed."""
        return np.degrees(-np.unwrap(np.angle(self.amplitude), axis=0))


def first_order(
    values: Array, phase: Array, speed: Array, order: float = 1.0, turns: int = 6
) -> FirstOrder | None:
    """Amplitude and phase lag at one order, by least squares over slices of a few turns."""
    angle = np.abs(phase - phase[0])
    slices = int(angle[-1] / (2 * np.pi * turns)) * 2 - 1
    if slices < 3:
        return None
    amplitudes, at = [], []
    sign = 1.0 if np.mean(speed) >= 0 else -1.0
    for k in range(min(slices, 2 * _SLICES)):
        low = np.pi * turns * k
        a, b = np.searchsorted(angle, (low, low + 2 * np.pi * turns))
        if b - a < 8:
            continue
        turned = sign * order * phase[a:b]
        basis = np.column_stack([np.cos(turned), np.sin(turned), np.ones(b - a)])
        cosine, sine, _ = np.linalg.lstsq(basis, values[a:b], rcond=None)[0]
        amplitudes.append(cosine - 1j * sine)
        at.append(float(np.mean(speed[a:b])))
    return FirstOrder(np.array(at), np.array(amplitudes)) if len(amplitudes) >= 3 else None


def full_spectrum(x: Array, y: Array, dt: float, backward: bool = False) -> tuple[Array, Array]:
    """Two-sided spectrum of x + i y: forward whirl at positive, backward at negative frequency.

    ``backward``: the rotor turns clockwise, so that forward is the other side. Returns frequencies
    in Hz and amplitudes in the unit of x, each (frequencies,).
    """
    window = np.hanning(len(x))
    motion = (x - x.mean()) + 1j * (y - y.mean()) * (-1.0 if backward else 1.0)
    amplitude = np.abs(np.fft.fft(motion * window)) / window.sum()
    return np.fft.fftshift(np.fft.fftfreq(len(x), dt)), np.fft.fftshift(amplitude)


def correlations(values: Array, others: Array, lags: int) -> Array:
    """rho_k = corr(values[t], others[t + k]) for k = -lags .. lags, (2 lags + 1,)."""
    from scipy.signal import correlate

    a, b = values - values.mean(), others - others.mean()
    scale = float(np.sqrt(np.sum(a * a) * np.sum(b * b))) or 1.0
    whole = correlate(b, a, mode="full", method="fft") / scale
    middle = len(a) - 1
    return whole[middle - lags : middle + lags + 1]
