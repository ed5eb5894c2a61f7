"""Inputs described in a few words: a sweep, a constant, noise, a multisine, a chirp.

{sweep: [40, 0], unit: Hz}          a + (b - a) t / T
{constant: 30, unit: Hz}            a
{noise: 1.0, band: [5, 200]}        white in the band, root mean square 1.0
{multisine: 1.0, band: [5, 200]}    equal lines, random phases, root mean square 1.0
{chirp: 1.0, band: [5, 200]}        a sin 2 pi (f0 t + (f1 - f0) t^2 / 2T)
{noise: 0.5, offset: 3.0}           any of them about a mean
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.record import Array
from spiral.types.units import conversion

FORMS = ("sweep", "constant", "noise", "multisine", "chirp")
_EXAMPLE = "{sweep: [40, 0], unit: Hz}, {constant: 30}, {noise: 1.0, band: [5, 200]}"


def excite(name: str, description: Any, time: Array, unit: str, rng: np.random.Generator) -> Array:
    """Samples of a described input on a time grid, in ``unit``.

    Parameters
    ----------
    name : of the input, for messages.
    description : a mapping as in the module's table, or a number for a constant.
    time : (samples,) s, uniform, from zero.
    unit : the system's unit; the description may name another.
    rng : draws noise and phases.

    Raises
    ------
    ConfigError : an unknown form or option, or numbers that do not fit.
    """
    if isinstance(description, int | float) and not isinstance(description, bool):
        description = {"constant": description}
    form, description = _parse_form(name, description)
    given = description.get("unit")
    scale, zero = conversion(str(given), unit, name) if given else (1.0, 0.0)
    size = _check_numbers(name, form, description[form], 2 if form == "sweep" else 1)
    offset = zero + scale * _check_numbers(name, "offset", description.get("offset", 0.0), 1)[0]
    return offset + scale * _waveform(name, form, size, description.get("band"), time, rng)


def _waveform(
    name: str, form: str, size: list[float], band: Any, time: Array, rng: np.random.Generator
) -> Array:
    duration = (time[1] - time[0]) * len(time)
    if form == "sweep":
        return size[0] + (size[1] - size[0]) * time / duration
    if form == "constant":
        return np.full(len(time), size[0])
    low, high = _band_limits(name, band, time, duration)
    if form == "chirp":
        turns = low * time + 0.5 * (high - low) * time**2 / duration
        return size[0] * np.sin(2 * np.pi * turns)
    return size[0] * _random_signal(form, len(time), duration, low, high, rng)


def _parse_form(name: str, description: Any) -> tuple[str, Mapping[str, Any]]:
    if not isinstance(description, Mapping):
        raise ConfigError(
            f"input {name!r} described as {description!r}", f"for instance {_EXAMPLE}"
        )
    forms = [f for f in FORMS if f in description]
    known = (*FORMS, "unit", "band", "offset")
    for key in description:
        if key not in known:
            raise ConfigError(
                f"{key!r} in the description of input {name!r}",
                f"one of {', '.join(known)}",
                did_you_mean(str(key), known),
            )
    if len(forms) != 1:
        raise ConfigError(
            f"input {name!r} with {len(forms)} forms",
            f"one of {', '.join(FORMS)}",
            f"for instance {_EXAMPLE}",
        )
    return forms[0], description


def _check_numbers(name: str, key: str, value: Any, count: int) -> list[float]:
    values = list(value) if isinstance(value, list | tuple) else [value]
    fit = all(
        isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v) for v in values
    )
    if not fit or len(values) != count:
        raise ConfigError(
            f"{key}: {value!r} of input {name!r}",
            "a number" if count == 1 else f"a list of {count} numbers",
            f"for instance {_EXAMPLE}",
        )
    return [float(v) for v in values]


def _band_limits(name: str, band: Any, time: Array, duration: float) -> tuple[float, float]:
    rate = len(time) / duration
    if band is None:
        return 1.0 / duration, 0.4 * rate
    low, high = _check_numbers(name, "band", band, 2)
    if not 0 <= low < high <= 0.5 * rate:
        raise ConfigError(
            f"band {band} Hz of input {name!r}",
            f"0 <= low < high <= {0.5 * rate:g} Hz, half the sample rate",
            "raise record.rate, or lower the band",
        )
    return low, high


def _random_signal(
    form: str, samples: int, duration: float, low: float, high: float, rng: np.random.Generator
) -> Array:
    """Lines of one period of ``duration`` in the band, root mean square 1."""
    frequency = np.fft.rfftfreq(samples, duration / samples)
    inside = (frequency >= low) & (frequency <= high) & (frequency > 0)
    count = int(inside.sum())
    if count == 0:
        raise ConfigError(
            f"a band of {low:g} to {high:g} Hz in {duration:g} s",
            "a band that holds at least one period of the record",
            "simulate longer, or widen the band",
        )
    lines = np.zeros(len(frequency), dtype=complex)
    if form == "noise":
        lines[inside] = rng.normal(size=count) + 1j * rng.normal(size=count)
    else:
        lines[inside] = np.exp(2j * np.pi * rng.random(count))
    values = np.fft.irfft(lines, samples)
    return values / np.sqrt(np.mean(values**2))
