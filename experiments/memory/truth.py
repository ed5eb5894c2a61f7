"""Machines with a force that has memory, and with what may be taken for one, simulated apart.

    m x'' + c x' + k x = u + F,      m = 1 kg, c = 4 N s/m, k = 400 N/m (3.2 Hz)

by classical Runge-Kutta steps of a fifth of a sample, in equations of this file alone; u is noise
between 0 and 8 Hz. Sizes are drawn for every case: a stiffness ``s`` of 0.2 to 0.6 of the spring, a
length ``d`` of 0.2 to 0.6 of the usual motion (0.01 m).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import copysign, exp, sin, tanh

import numpy as np

Array = np.ndarray
MASS, DAMPING, SPRING, RATE, FINE, MOTION = 1.0, 4.0, 400.0, 100.0, 5, 0.01
_PUSH, _BAND = 2.5, 8.0  # N rms, Hz
_SAMPLES, _TESTED = 2500, 1000

State = Sequence[float]
Force = Callable[[float, float, State, float], tuple[float, list[float]]]
"""F and z' by position, velocity, own states z and time."""


@dataclass(frozen=True)
class Machine:
    """What acts beside the linear machine: a force with ``own`` states, and what is random.

    ``random`` is the rms of a random force in N, correlated over ``lasting`` s (0: white over one
    sample); ``averaged`` the samples that the sensor takes the mean of; ``coloured`` the
    correlation from sample to sample of its noise.
    """

    force: Force
    own: int = 0
    random: float = 0.0
    lasting: float = 0.0
    averaged: int = 1
    coloured: float = 0.0


def _still(q: float, v: float, z: State, t: float) -> tuple[float, list[float]]:
    return 0.0, []


# --- with memory ---------------------------------------------------------------------------------


def bouc_wen(s: float, d: float) -> Machine:
    """z' = v - 0.7 |v| |z| z / d^2 - 0.3 v z^2 / d^2, exponent two (Wen 1976)."""

    def force(q, v, z, t):
        (z,) = z
        return -s * z, [v - (0.7 * abs(v) * abs(z) * z + 0.3 * v * z * z) / d**2]

    return Machine(force, 1)


def dahl(s: float, d: float) -> Machine:
    """z' = v (1 - sgn(v) z / d)^1.5 (Dahl 1976)."""

    def force(q, v, z, t):
        left = 1 - copysign(1.0, v) * z[0] / d
        return -s * z[0], [v * abs(left) ** 0.5 * left]

    return Machine(force, 1)


def iwan(s: float, d: float) -> Machine:
    """Six springs in parallel that slide at forces spread from 0.25 to 1.75 of the mean."""
    limits = [d * (0.25 + 0.3 * i) for i in range(6)]

    def force(q, v, z, t):
        rates = [0.0 if a * v > 0 and abs(a) >= m else v for a, m in zip(z, limits, strict=True)]
        return -s / 6 * sum(z), rates

    return Machine(force, 6)


def lugre(s: float, d: float) -> Machine:
    """z' = v - |v| z / g(v), F = -(s z + s1 z'), g from 1.3 d at rest to d (Canudas 1995)."""
    turn, inner = 0.3 * MOTION * 20.0, 0.002 * s

    def force(q, v, z, t):
        rate = v - abs(v) * z[0] / (d * (1 + 0.3 * exp(-((v / turn) ** 2))))
        return -s * z[0] - inner * rate, [rate]

    return Machine(force, 1)


def maxwell(s: float, d: float) -> Machine:
    """T z' = T v - z, F = -s z, T = 0.05 to 0.15 s with the length: a spring on a damper."""
    time = 0.1 * d / (0.4 * MOTION)
    return Machine(lambda q, v, z, t: (-s * z[0], [v - z[0] / time]), 1)


def relaxation(s: float, d: float) -> Machine:
    """T z' = tanh(q / d) - z, F = -1.5 s d z, T = 0.08 s: a saturating force that comes late."""
    return Machine(lambda q, v, z, t: (-1.5 * s * d * z[0], [(tanh(q / d) - z[0]) / 0.08]), 1)


# --- both ----------------------------------------------------------------------------------------


def hardening(s: float, d: float) -> Machine:
    """Bouc-Wen, half as stiff, beside a spring that is twice as stiff at 1.6 times the motion."""
    yielding = bouc_wen(0.5 * s, d).force

    def force(q, v, z, t):
        given, rates = yielding(q, v, z, t)
        return given - SPRING * q**3 / (1.6 * MOTION) ** 2, rates

    return Machine(force, 1)


# --- without -------------------------------------------------------------------------------------


def _static(curve: Callable[[float, float], float], **more) -> Machine:
    return Machine(lambda q, v, z, t: (curve(q, v), []), **more)


def nothing(s: float, d: float) -> Machine:
    """The linear machine."""
    return Machine(_still)


def sine(s: float, d: float) -> Machine:
    """F = -s d sin(q / d): in no catalog."""
    return _static(lambda q, v: -s * d * sin(q / d))


def asymmetric(s: float, d: float) -> Machine:
    """A spring twice as stiff on one side, with a kink at a quarter of the motion."""
    return _static(lambda q, v: -2 * s * max(q - 0.25 * MOTION, 0.0))


def dry(s: float, d: float) -> Machine:
    """Dry friction, F = -s d / 2 tanh(v / w), w a fiftieth of the usual velocity."""
    return _static(lambda q, v: -0.5 * s * d * tanh(v / 0.004))


def stribeck(s: float, d: float) -> Machine:
    """F = -s d / 4 (1 + exp(-(v / v_s)^2)) tanh(v / w): falls with speed; in no catalog here."""
    return _static(lambda q, v: -0.25 * s * d * (1 + exp(-((v / 0.05) ** 2))) * tanh(v / 0.004))


def place_friction(s: float, d: float) -> Machine:
    """A damper that depends on place, F = -c (q / d)^2 v / (1 + (q / d)^2): in no catalog."""
    return _static(lambda q, v: -0.1 * s / 20 * (q / d) ** 2 * v / (1 + (q / d) ** 2))


def gusts(s: float, d: float) -> Machine:
    """A random force, correlated over 0.1 s, of a fifth of the applied one."""
    return Machine(_still, random=0.2 * _PUSH, lasting=0.1)


def rattle(s: float, d: float) -> Machine:
    """A random force without correlation, of a fifth of the applied one."""
    return Machine(_still, random=0.2 * _PUSH)


def drifting(s: float, d: float) -> Machine:
    """A spring that softens by 2 to 6 % over the record."""
    length = _SAMPLES / RATE
    return Machine(lambda q, v, z, t: (0.1 * s * q * t / length, []))


def averaged(s: float, d: float) -> Machine:
    """A sensor that reports the mean of its last five samples."""
    return Machine(_still, averaged=5)


def coloured(s: float, d: float) -> Machine:
    """A sensor whose noise is correlated, 0.8 from sample to sample."""
    return Machine(_still, coloured=0.8)


MEMORY = {f.__name__: f for f in (bouc_wen, dahl, iwan, lugre, maxwell, relaxation)}
NO_MEMORY = {
    f.__name__: f
    for f in (nothing, sine, asymmetric, dry, stribeck, place_friction, gusts, rattle, drifting,
              averaged, coloured)
}  # fmt: skip
BOTH = {"hardening": hardening}


@dataclass(frozen=True)
class Simulated:
    """Positions and forces of a record and of its test, and the noise of the sensor in m."""

    force: tuple[Array, Array]
    reading: tuple[Array, Array]
    noise: float = field(default=0.0)


def simulated(kind: str, noise: float, seed: int) -> Simulated:
    """A record of 25 s and a test of 10 s, ``noise`` a share of the motion's deviation."""
    makers = {**MEMORY, **NO_MEMORY, **BOTH}
    draws = np.random.default_rng([seed, list(makers).index(kind), round(1e4 * noise)])
    size, length = SPRING * draws.uniform(0.2, 0.6), MOTION * draws.uniform(0.2, 0.6)
    machine = makers[kind](size, length)
    forces, motions = [], []
    for samples in (_SAMPLES, _TESTED):
        push = _low_passed(draws, samples)
        forces.append(push)
        motions.append(_averaged(_integrated(machine, push, draws), machine.averaged))
    spread = noise * float(np.std(motions[0]))
    readings = [y + spread * _noise(draws, len(y), machine.coloured) for y in motions]
    return Simulated(tuple(forces), tuple(readings), spread)


def _low_passed(draws: np.random.Generator, samples: int) -> Array:
    """Noise of ``_PUSH`` N rms under ``_BAND`` Hz, without anything above."""
    spectrum = np.fft.rfft(draws.normal(size=samples))
    spectrum[np.fft.rfftfreq(samples, 1 / RATE) > _BAND] = 0.0
    found = np.fft.irfft(spectrum, samples)
    return _PUSH * found / found.std()


def _noise(draws: np.random.Generator, samples: int, correlation: float) -> Array:
    from scipy.signal import lfilter

    white = draws.normal(size=samples)
    if not correlation:
        return white
    return np.sqrt(1 - correlation**2) * lfilter([1.0], [1.0, -correlation], white)


def _averaged(y: Array, width: int) -> Array:
    """The mean of the last ``width`` samples."""
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(y, width, origin=width // 2) if width > 1 else y


def _integrated(machine: Machine, push: Array, draws: np.random.Generator) -> Array:
    """Positions at the samples, from rest."""
    from scipy.signal import resample

    fine, step = resample(push, 2 * FINE * len(push)), 1 / RATE / FINE
    random = _gusts(machine, len(push), draws)
    x, found = [0.0] * (2 + machine.own), np.zeros(len(push))

    def rate(x: list[float], u: float, t: float) -> list[float]:
        q, v, *z = x
        extra, own = machine.force(q, v, z, t)
        return [v, (u + extra - DAMPING * v - SPRING * q) / MASS, *own]

    for k in range(len(push)):
        found[k] = x[0]
        for j in range(FINE):
            at, t = 2 * (k * FINE + j), (k * FINE + j) * step
            u = [fine[min(at + i, len(fine) - 1)] + random[k] for i in range(3)]
            a = rate(x, u[0], t)
            b = rate([p + step / 2 * r for p, r in zip(x, a, strict=True)], u[1], t)
            c = rate([p + step / 2 * r for p, r in zip(x, b, strict=True)], u[1], t)
            d = rate([p + step * r for p, r in zip(x, c, strict=True)], u[2], t)
            x = [p + step / 6 * (a + 2 * b + 2 * c + d)
                 for p, a, b, c, d in zip(x, a, b, c, d, strict=True)]  # fmt: skip
    return found


def _gusts(machine: Machine, samples: int, draws: np.random.Generator) -> Array:
    """The random force, one value to a sample."""
    if not machine.random:
        return np.zeros(samples)
    kept = exp(-1 / RATE / machine.lasting) if machine.lasting else 0.0
    return machine.random * _noise(draws, samples, kept)
