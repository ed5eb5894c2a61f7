"""What a sensor reports instead of what is there: the motion stays as it is.

A reading y is one value for each measured channel; q and q' are the true values and their rates.
"""

from __future__ import annotations

import math

from spiral_plugins.effects.late import (
    SCALE,
    delay_curvature,
    delayed,
    half_sample_remark,
    lag_contradiction,
    late_by,
    times_of,
)

from spiral.math import cos, sin
from spiral.types.effect import SensorEffect
from spiral.types.parameter import Parameter, State

_TURN = 6.283185307179586
_CONVERSIONS = (
    (180 / math.pi, "rad", "degrees"),
    (2 * math.pi, "turns", "rad"),
    (30 / math.pi, "rad/s", "rpm"),
    (9.80665, "g", "m/s^2"),
    (60.0, "minutes", "seconds"),
    (3600.0, "hours", "seconds"),
    (3.6, "m/s", "km/h"),
    (25.4, "inches", "mm"),
    (14.503774, "bar", "psi"),
    (4.4482216, "lbf", "N"),
)  # a number of the first unit times the factor is one of the second
_UNITS = {
    **{10.0**k: f"10^{k}" for k in (-9, -6, -3, -2, 2, 3, 6, 9)},
    **{factor: f"{one} to {other}" for factor, one, other in _CONVERSIONS},
    **{1 / factor: f"{other} to {one}" for factor, one, other in _CONVERSIONS},
}  # of factors: what they convert


class Offset(SensorEffect):
    """A sensor whose zero is off: y_i + b_i, reading = y + b.

    In a linear machine a constant load looks the same.
    """

    parameters = (Parameter("offset", "position", per_axis=True),)

    def reading(self, y, at, u, p):
        """y_i + b_i."""
        return [value + b for value, b in zip(y, p.offset, strict=True)]


class Gain(SensorEffect):
    """A sensor whose scale is off: reading = (1 + e_i) y_i.

    A common factor of all channels looks like larger forces (an unbalance) in a linear machine.
    """

    twins = ("input_gain",)
    parameters = (Parameter("error", "", per_axis=True),)

    def reading(self, y, at, u, p):
        """(1 + e_i) y_i."""
        return [value + e * value for value, e in zip(y, p.error, strict=True)]

    def remark(self, values, step):
        """Remarks on a scale that no sensor is wrong by."""
        return scale_remark(1 + error for error in values.values())


class CrossSensitivity(SensorEffect):
    """A sensor that also reads something else: reading = y + c v, v an input or another state.

    A drive that couples into a pick-off, a thermometer in the sun, a strain gauge that follows
    temperature, a load cell that feels pressure, a gyro that feels the pull of gravity.
    """

    driver = "any"
    parameters = (Parameter("gain", "force/position"),)

    def reading(self, y, at, u, p):
        """y + c v."""
        (value,), (other,) = y, at.position
        return [value + p.gain * other]


class AxisRotation(SensorEffect):
    """A probe pair turned by a small angle: reading = (x + a y, y - a x), first order in a.

    Turned principal axes of the support (``cross_stiffness``) look nearly the same.
    """

    axes = 2
    parameters = (Parameter("angle", "rad"),)

    def reading(self, y, at, u, p):
        """(x + a y, y - a x)."""
        first, second = y
        return [first + p.angle * second, second - p.angle * first]


class Delay(SensorEffect):
    """A sensor that reports late by T_i: reading = y_i + (q_i(t - T_i) - q_i).

    Transport of a sample, a bus, averaging in an instrument. Twice T / 2, each with states a and b
    of a time z / 2, z near T, for each channel,

        z a' = 2 b,  z b' = 2 c,  c = 12 (q - a) - 6 b,  r = T / z,
        q(t - T / 2) = q - r b + (r^2 - r) c / 2,

    right to the second order in T whatever z is, and with z = T Pade's second approximation twice
    (as ``input_delay``). All sensors late by one time look like an input that acts so much later.
    """

    states = (
        State("level", "position", per_axis=True, like="position"),
        State("slope", "position", per_axis=True),
        State("later_level", "position", per_axis=True, like="position"),
        State("later_slope", "position", per_axis=True),
    )
    twins = ("input_delay", "actuator_lag")
    whole = {"time": "scale"}
    parameters = (Parameter("time", "s", per_axis=True), SCALE)

    def reading(self, y, at, u, p):
        """y_i + q_i(t - T_i) - q_i."""
        halfway = self._halfway(at, p)
        rows = zip(y, at.position, halfway, at.own.later_level, at.own.later_slope, strict=True)
        ratios = [late / p.scale for late in p.time]
        return [
            value - q + delayed(h, a, b, r)
            for (value, q, h, a, b), r in zip(rows, ratios, strict=True)
        ]

    def rate(self, at, u, p):
        """2 b / z and 2 c / z of both halves."""
        own, half = at.own, p.scale / 2
        halfway = self._halfway(at, p)
        return {
            "level": [b / half for b in own.slope],
            "slope": _curvatures(at.position, own.level, own.slope, half),
            "later_level": [b / half for b in own.later_slope],
            "later_slope": _curvatures(halfway, own.later_level, own.later_slope, half),
        }

    def _halfway(self, at, p):
        rows = zip(at.position, at.own.level, at.own.slope, p.time, strict=True)
        return [delayed(q, a, b, late / p.scale) for q, a, b, late in rows]

    def limit_values(self, values):
        """A lag of the same time."""
        return late_by(times_of(values))

    def remark(self, values, step):
        """Remarks on a negative delay, and on one of half a sample."""
        times = times_of(values)
        if max(times) < 0:
            return f"no sensor is early: the inputs are recorded {-max(times):.2g} s or more late"
        return half_sample_remark(min(times), step)


def _curvatures(given, levels, slopes, time):
    rows = zip(given, levels, slopes, strict=True)
    return [delay_curvature(q, a, b) / time for q, a, b in rows]


class SensorLag(SensorEffect):
    """A sensor that follows slowly, 1 / (1 + T_i s): reading = y_i - T_i / z (q_i - a_i).

    A first-order low-pass (a thermocouple, a probe, a filter in an amplifier). Its state follows
    the true value in a time z near T,

        z a' = q - a,

    so that with z = T the reading is a, exactly; with another z it is right to the first order in
    T. It differs from a ``delay`` in the second order alone, which slow motion does not show.
    """

    states = (State("level", "position", per_axis=True, like="position"),)
    twins = ("actuator_lag", "input_delay")
    whole = {"time": "scale"}
    parameters = (Parameter("time", "s", per_axis=True, lower=0.0), SCALE)

    def reading(self, y, at, u, p):
        """y_i - T_i / z (q_i - a_i)."""
        rows = zip(y, at.position, at.own.level, p.time, strict=True)
        return [value - late / p.scale * (q - a) for value, q, a, late in rows]

    def rate(self, at, u, p):
        """(q_i - a_i) / z."""
        rows = zip(at.position, at.own.level, strict=True)
        return {"level": [(q - a) / p.scale for q, a in rows]}

    def limit_values(self, values):
        """An actuator's lag or a delay of the same time."""
        return late_by(times_of(values))

    def contradiction(self, fitted):
        """With T near 2 z it is Pade's first approximation of a delay of T, and no lag."""
        return lag_contradiction(fitted, "what it reports")


def scale_remark(factors):
    """The remark on a factor beyond 1/2 to 2, or below zero; empty where there is none."""
    worst = max(factors, key=lambda f: abs(math.log(max(abs(f), 1e-300))))
    if worst < 0:
        return f"a factor of {worst:.4g} turns the sign: a channel or an input has the other sense"
    if 0.5 <= worst <= 2:
        return ""
    nearest = min(_UNITS, key=lambda f: abs(math.log(worst / f)))
    told = f" (near {_UNITS[nearest]})" if 0.97 < worst / nearest < 1.03 else ""
    return f"a factor of {worst:.4g}{told} is a wrong unit or range sooner than a wrong scale"


class Runout(SensorEffect):
    """A shaft out of round, seen once per turn: reading = y + a (cos t, sin t) + b (-sin t, cos t).

    t is the phase. Its size does not change with speed, so a sweep tells it from an unbalance, and
    no resonance amplifies it, unlike a bow.
    """

    axes = 2
    inputs = ("phase",)
    parameters = (Parameter("cosine", "position"), Parameter("sine", "position"))

    def reading(self, y, at, u, p):
        """y + (a cos t - b sin t, a sin t + b cos t)."""
        c, s = cos(u.phase), sin(u.phase)
        return [y[0] + p.cosine * c - p.sine * s, y[1] + p.cosine * s + p.sine * c]


class MainsHum(SensorEffect):
    """A line of the mains in the readings: reading = y_i + a_i cos 2 pi f t + b_i sin 2 pi f t.

    Its phase is each record's own, so its amplitudes are as well.
    """

    inputs = ("time",)
    parameters = (
        Parameter("cosine", "position", per_axis=True, scope="record"),
        Parameter("sine", "position", per_axis=True, scope="record"),
        Parameter("frequency", "Hz", lower=0.0, role="shape", grid=(50.0, 60.0), search=0.004),
    )

    def reading(self, y, at, u, p):
        """y_i + a_i cos 2 pi f t + b_i sin 2 pi f t."""
        angle = _TURN * p.frequency * u.time
        return [
            value + a * cos(angle) + b * sin(angle)
            for value, a, b in zip(y, p.cosine, p.sine, strict=True)
        ]
