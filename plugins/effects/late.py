"""What is late: the states of a delay, and what all effects that are late have in common."""

from __future__ import annotations

from spiral.types.parameter import Parameter, State

SCALE = Parameter("scale", "s", lower=0.0, role="shape", start=0.01, spectrum=True)
_NEAR = 0.1  # samples around half a sample
_LATE = 1.5  # T over z halfway between a lag (1) and a delay (2)


def late_by(times):
    """How each effect that is late names its values, for one whose axes are late by these times.

    By their mean; nothing where that is no delay.
    """
    late = sum(times) / len(times)
    return {"time": late, "scale": late, "share": 1.0, "time_constant": late} if late > 0 else {}


def times_of(values):
    """The times by which the axes of a late effect are late."""
    return [v for k, v in values.items() if k.startswith("time")]


def delay_curvature(given, level, slope):
    """c = 12 (q - a) - 6 b of the states of a half of a delay."""
    return 12 * (given - level) - 6 * slope


def delayed(given, level, slope, ratio):
    """q(t - T / 2) = q - r b + (r^2 - r) c / 2, r = T / z."""
    bent = delay_curvature(given, level, slope)
    return given - ratio * slope + (ratio * ratio - ratio) * bent / 2


def half_sample_remark(late, step):
    """The remark on a delay near half a sample step; empty for any other delay."""
    if not abs(late / step - 0.5) < _NEAR:
        return ""
    return (
        f"{late:.2g} s is half a sample, as where a controller holds an input to the next sample: "
        "record.hold=zero_order if it does"
    )


def lag_contradiction(fitted, shown):
    """Why ``shown`` is no lag with these values: Pade's first approximation of a delay of T."""
    times = times_of(fitted)
    if "scale" not in fitted or not times or max(times) < _LATE * fitted["scale"]:
        return ""
    return f"{shown} first goes the other way, as after a delay and never after a lag"


class DelayedValue:
    """One value q that is late by T: twice T / 2, with states a and b of a time z / 2 each.

    z near T, and

        z a' = 2 b,  z b' = 2 c,  c = 12 (q - a) - 6 b,  r = T / z,
        q(t - T / 2) = q - r b + (r^2 - r) c / 2,

    right to the second order in T whatever z is, and with z = T Pade's second approximation (Baker,
    Graves-Morris, Pade Approximants) twice: right in phase to (2 pi f T)^5 / 11520 at the frequency
    f. Linear in T to leading order only. The part that effects of one value have in common.
    """

    states = (
        State("level", "position", like="position"),
        State("slope", "position"),
        State("later_level", "position", like="position"),
        State("later_slope", "position"),
    )
    whole = {"time": "scale"}
    parameters = (Parameter("time", "s", lower=0.0), SCALE)

    def late_value(self, at, p):
        """q(t - T), late by T / 2 once more."""
        halfway = self._halfway(at, p)
        return delayed(halfway, at.own.later_level, at.own.later_slope, p.time / p.scale)

    def rate(self, at, u, p):
        """2 b / z and 2 c / z of both halves."""
        own, half, (given,) = at.own, p.scale / 2, at.position
        halfway = self._halfway(at, p)
        return {
            "level": own.slope / half,
            "slope": delay_curvature(given, own.level, own.slope) / half,
            "later_level": own.later_slope / half,
            "later_slope": delay_curvature(halfway, own.later_level, own.later_slope) / half,
        }

    def _halfway(self, at, p):
        return delayed(at.position[0], at.own.level, at.own.slope, p.time / p.scale)

    def limit_values(self, values):
        """A lag of the same time."""
        return late_by([values["time"]])
