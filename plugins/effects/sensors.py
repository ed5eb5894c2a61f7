"""What a sensor reports instead of what is there: the motion stays as it is.

A reading y is one value for each measured channel; q and q' are the true values and their rates.
"""

from __future__ import annotations

from spiral.math import cos, sin
from spiral.types.effect import SensorEffect
from spiral.types.parameter import Parameter

_TURN = 6.283185307179586
_NEAR = 0.1  # samples around half a sample


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
    """A sensor that reports late: reading = y_i - tau_i q_i' + tau_i^2 q_i'' / 2.

    Right where tau is short against a period: at the frequency f the third order is (2 pi f
    tau)^3 / 6 of the motion. Where q_i' is no state of the system (a level, a temperature) the
    second order is left out, (2 pi f tau)^2 / 2 of the motion. All sensors late by one time look
    like an input that acts so much later.
    """

    twins = ("input_delay", "actuator_lag")
    parameters = (Parameter("time", "s", per_axis=True),)

    def reading(self, y, at, u, p):
        """y_i - tau_i q_i' + tau_i^2 q_i'' / 2."""
        return _late(y, at, p.time, 1 / 2)

    def remark(self, values, step):
        """A sensor cannot be early, and half a sample has a usual cause."""
        times = [v for k, v in values.items() if k.startswith("time")]
        if max(times) < 0:
            return f"no sensor is early: the inputs are recorded {-max(times):.2g} s or more late"
        return half_a_sample(min(times), step)


class SensorLag(SensorEffect):
    """A sensor that follows slowly, 1 / (1 + T s): reading = y_i - T_i q_i' + T_i^2 q_i''.

    A first-order low-pass (a thermocouple, a filter in an amplifier), right where T is short
    against a period: at the frequency f the third order is (2 pi f T)^3 of the motion. It differs
    from a ``delay`` in the second order alone, which slow motion does not show; where q_i' is no
    state of the system (a level, a temperature) they are one.
    """

    twins = ("actuator_lag", "input_delay")
    parameters = (Parameter("time", "s", per_axis=True),)

    def reading(self, y, at, u, p):
        """y_i - T_i q_i' + T_i^2 q_i''."""
        return _late(y, at, p.time, 1)


def half_a_sample(late, step):
    """What is said of something that comes late by half the time between samples."""
    if not abs(late / step - 0.5) < _NEAR:
        return ""
    return (
        f"{late:.2g} s is half a sample, as where a controller holds an input to the next sample: "
        "record.hold=zero_order if it does"
    )


def _late(y, at, times, share):
    """y_i - T_i q_i' + share T_i^2 q_i''."""
    second = at.acceleration or (0,) * len(at.velocity)
    rows = zip(y, times, at.velocity, second, strict=True)
    return [value - late * v + share * late * late * a for value, late, v, a in rows]


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
