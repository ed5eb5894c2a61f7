"""The imperfections: what acts on the machine, what the sensors make of it, what a record says.

Sizes are relative to the standard deviation of each channel; all records have noise of 2 % as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from experiments.imperfections.motion import Push

Array = np.ndarray
NOISE = 0.02
"""Of every channel, as a share of its standard deviation."""
Noise = Callable[[np.random.Generator, Array], Array]
"""(what draws, the clean channel) -> noise of unit standard deviation."""
Reading = Callable[[np.random.Generator, Array, float, float], Array]
"""(what draws, a channel, step in s, resonance in rad/s) -> what the sensor makes of it."""


def white(rng: np.random.Generator, clean: Array) -> Array:
    """N(0, 1)."""
    return rng.normal(size=len(clean))


def autoregressive(rng: np.random.Generator, clean: Array, memory: float) -> Array:
    """e_n = a e_{n-1} + sqrt(1 - a^2) N(0, 1)."""
    return _remembering(rng, len(clean), memory)


def band_limited(rng: np.random.Generator, clean: Array) -> Array:
    """White noise behind an anti-alias filter at a quarter of the sample rate."""
    from scipy.signal import butter, sosfilt

    low = butter(6, 0.25, fs=1.0, output="sos")
    found = np.asarray(sosfilt(low, rng.normal(size=len(clean) + 200)))[200:]
    return found / found.std()


def student(rng: np.random.Generator, clean: Array) -> Array:
    """Student's t with three degrees of freedom, its variance 3 divided out."""
    return rng.standard_t(3, size=len(clean)) / np.sqrt(3.0)


def growing(rng: np.random.Generator, clean: Array) -> Array:
    """Noise in proportion to 0.3 + |y| / std y."""
    size = 0.3 + np.abs(clean - clean.mean()) / clean.std()
    return rng.normal(size=len(clean)) * size / np.sqrt(np.mean(size**2))


def jitter(rng: np.random.Generator, clean: Array) -> Array:
    """White noise, and what samples are off that come 5 % of a step too early or late, rms."""
    off = _sampled(clean, rng.normal(0.0, 0.05, len(clean))) - clean
    return rng.normal(size=len(clean)) + off / (NOISE * clean.std())


def white_force(rng: np.random.Generator, count: int, step: float) -> Array:
    """White noise of unit density: N(0, 1) / sqrt(h)."""
    return rng.normal(size=count) / np.sqrt(step)


def coloured_force(rng: np.random.Generator, count: int, step: float, lasting: float) -> Array:
    """A force of unit variance with a correlation time in s (Ornstein, Uhlenbeck)."""
    return _remembering(rng, count, float(np.exp(-step / lasting)))


def _remembering(rng: np.random.Generator, count: int, memory: float) -> Array:
    from scipy.signal import lfilter

    drawn = rng.normal(size=count) * np.sqrt(1.0 - memory**2)
    drawn[0] = rng.normal()
    return np.asarray(lfilter([1.0], [1.0, -memory], drawn))


# --- what sensors make of a motion ----------------------------------------------------------------


def walked(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """A zero that wanders at random, 5 % rms."""
    path = np.cumsum(rng.normal(size=len(y)))
    return y + 0.05 * y.std() * path / np.sqrt(np.mean(path**2))


def ramped(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """A zero that warms up: 20 % over the record."""
    return y + 0.2 * y.std() * np.linspace(0.0, 1.0, len(y))


def shifted(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """A zero that is off by 10 %."""
    return y + 0.1 * y.std()


def lagged(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """T r' = y - r with T = 0.1 / resonance, on a grid ten times finer."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import cont2discrete, lfilter

    lag, fine = 0.1 / resonance, step / 10
    grid = np.arange((len(y) - 1) * 10 + 1) * fine
    dense = CubicSpline(np.arange(len(y)) * step, y)(grid)
    top, bottom, _ = cont2discrete(([1.0], [lag, 1.0]), fine, method="foh")
    return np.asarray(lfilter(np.squeeze(top), bottom, dense))[::10]


def late(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """Sampled half a step late."""
    return _sampled(y, np.full(len(y), -0.5))


def _sampled(y: Array, off: Array) -> Array:
    """At sample n + off_n, by a cubic spline."""
    from scipy.interpolate import CubicSpline

    n = np.arange(len(y))
    return CubicSpline(n, y)(np.clip(n + off, 0, len(y) - 1))


def spiked(
    rng: np.random.Generator, y: Array, step: float, resonance: float, share: float
) -> Array:
    """Single samples that are off by five standard deviations to either side."""
    at = rng.random(len(y)) < share
    return y + at * rng.choice([-5.0, 5.0], len(y)) * y.std()


def held(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """Telegrams lost: one sample in a hundred begins five that repeat the last value."""
    found = y.copy()
    for first in np.flatnonzero(rng.random(len(y)) < 0.01):
        found[first : first + 5] = found[max(first - 1, 0)]
    return found


def clipped(rng: np.random.Generator, y: Array, step: float, resonance: float) -> Array:
    """A sensor that stops at 80 % of the largest reading."""
    limit = 0.8 * np.abs(y).max()
    return np.clip(y, -limit, limit)


def quantised(
    rng: np.random.Generator, y: Array, step: float, resonance: float, bits: int
) -> Array:
    """A converter of so many bits over 1.2 times the largest reading to either side."""
    size = 2.4 * np.abs(y).max() / 2**bits
    return size * np.round(y / size)


# --- rows -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Imperfection:
    """One row of the table.

    Parameters
    ----------
    words : of which one should be in the sentence that names it.
    also : effects of the catalog that are this imperfection, so that naming them is right.
    noise : the shape of the 2 % noise. before, after : what a sensor makes of the motion, and of
        the motion with its noise. last : only of the last channel. spoils : ``after`` spoils single
        samples, the others hold the noise alone.
    push, lasting, share : a random force, its correlation time over 1 / resonance, and its size.
    drift : of every stiffness over the record.
    input_noise, input_late : of the recorded inputs: a share of their rms, and samples.
    declared : noise as the record declares it, over the truth; nothing where undeclared.
    """

    words: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    noise: Noise = white
    before: Reading | None = None
    after: Reading | None = None
    last: bool = False
    spoils: bool = False
    push: Push | None = None
    lasting: float = 0.0
    share: float = 0.0
    drift: float = 0.0
    input_noise: float = 0.0
    input_late: int = 0
    declared: float | None = None


_RANDOM = ("random force", "process noise", "disturb")
_COLOUR = ("coloured", "correlated", "autoregress", "band-limited", "not white")
_DRIFT = ("drift", "wander", "trend")
_OUTLIERS = ("outlier", "spike", "heavy tail", "dropout")

_STIFFNESS, _DRIFTING = ("drift", "stiffness"), ("stiffness_drift", "speed_stiffness")
ROWS: dict[str, Imperfection] = {
    "white": Imperfection(),
    "ar_0.5": Imperfection(_COLOUR, noise=partial(autoregressive, memory=0.5)),
    "ar_0.9": Imperfection(_COLOUR, noise=partial(autoregressive, memory=0.9)),
    "band_limited": Imperfection(_COLOUR, noise=band_limited),
    "process_2": Imperfection(_RANDOM, push=white_force, share=0.02),
    "process_5": Imperfection(_RANDOM, push=white_force, share=0.05),
    "process_10": Imperfection(_RANDOM, push=white_force, share=0.10),
    "wind": Imperfection(_RANDOM, push=white_force, lasting=3.0, share=0.10),
    "slow_force": Imperfection(
        (*_RANDOM, "slow"), ("constant_load", "offset"), push=white_force, lasting=100.0, share=0.10
    ),
    "walk": Imperfection(_DRIFT, ("offset", "constant_load"), before=walked),
    "ramp": Imperfection(_DRIFT, ("offset", "constant_load"), before=ramped),
    "offset": Imperfection(("offset",), ("offset", "constant_load"), before=shifted),
    "lag": Imperfection(("lag", "delay", "late"), ("delay", "lag", "sensor_lag"), before=lagged),
    "skew": Imperfection(("delay", "late", "skew"), ("delay",), before=late, last=True),
    "input_noise_1": Imperfection(("input",), input_noise=0.01),
    "input_noise_5": Imperfection(("input",), input_noise=0.05),
    "input_late": Imperfection(("delay", "late", "early"), ("delay", "input_delay"), input_late=1),
    "spikes_0.1": Imperfection(_OUTLIERS, after=partial(spiked, share=0.001), spoils=True),
    "spikes_1": Imperfection(_OUTLIERS, after=partial(spiked, share=0.01), spoils=True),
    "dropouts": Imperfection((*_OUTLIERS, "held", "repeat"), after=held, spoils=True),
    "clipping": Imperfection(("clip", "saturat"), after=clipped, spoils=True),
    "bits_8": Imperfection(("quanti", "resolution", "bit"), after=partial(quantised, bits=8)),
    "bits_12": Imperfection(("quanti", "resolution", "bit"), after=partial(quantised, bits=12)),
    "jitter": Imperfection(("jitter",), noise=jitter),
    "student_3": Imperfection(_OUTLIERS, noise=student),
    "amplitude_noise": Imperfection(("amplitude", "grows"), noise=growing),
    "stiffness_drift_1": Imperfection(_STIFFNESS, _DRIFTING, drift=0.01),
    "stiffness_drift_5": Imperfection(_STIFFNESS, _DRIFTING, drift=0.05),
    "declared_half": Imperfection(("declare", "said to be"), declared=0.5),
    "declared_double": Imperfection(("declare", "said to be"), declared=2.0),
}
"""Every row by name; each is asked once with an effect hidden and once with none."""
