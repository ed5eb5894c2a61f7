"""Spectral lines of records: where a line of nearly known frequency stands."""

from __future__ import annotations

import numpy as np

from spiral.types.record import Array, Record

_OVERSAMPLED = 4  # trial frequencies in the width of a line, 1/T


def strongest_line(
    records: tuple[Record, ...], frequency: float, within: float
) -> tuple[float, int] | None:
    """The frequency (Hz) near a nominal one at which the channels hold the strongest line.

    Maximises sum |Y(f)|^2 / var over channels and records, Y the Fourier transform of a channel
    under a Hann window, on a grid of 1/(4 T). Returns it with the number of independent
    frequencies looked at, 2 f within T + 1 (T s the longest record), by which a test on it must be
    corrected; or nothing where the records' Nyquist frequency lies below.
    """
    longest = max(r.samples * r.dt for r in records)
    half = max(within * frequency, 0.0)
    count = int(np.ceil(2 * half * longest)) + 1
    if frequency + half >= 0.5 / max(r.dt for r in records):
        return None
    trials = frequency + np.linspace(-half, half, _OVERSAMPLED * count + 1)
    power = np.sum([_spectral_power(r, trials) for r in records], axis=0)
    return float(trials[int(np.argmax(power))]), count


def _spectral_power(record: Record, trials: Array) -> Array:
    """Power of the channels at equally spaced frequencies, each channel over its variance.

    By the chirp z-transform, at a cost of n log n whatever the number of frequencies.
    """
    from scipy.signal import zoom_fft

    total = np.zeros(len(trials))
    window = np.hanning(record.samples)
    for values in record.channels.values():
        moving = (values - values.mean()) * window
        scale = float(moving @ moving)
        if scale == 0:
            continue
        band = 2 * record.dt * trials[[0, -1]]  # in half the sample rate
        turned = zoom_fft(moving, band, len(trials), endpoint=True)
        total += np.abs(turned) ** 2 / scale
    return total
