"""What an actuator makes of an input: the machine gets something else than the record says.

u is the recorded input, each effect gives the one that acts. An amplitude s is the share to which
an effect is there: 1 where the actuator is as the equation says.
"""

from __future__ import annotations

from spiral_plugins.effects.late import SCALE, DelayedValue, half_sample_remark, late_by
from spiral_plugins.effects.restoring import WIDTH, excess_over_gap
from spiral_plugins.effects.sensors import scale_remark

from spiral.math import length, tanh
from spiral.types.effect import InputEffect, StateFlow
from spiral.types.parameter import Parameter, State

_NEAR_TWO = 0.3  # around two, where a lag's share stands for a delay


def _partly_followed(at, p):
    """u - s (u - z), z what the actuator has followed to."""
    (given,) = at.position
    return given - p.share * (given - at.own.followed)


class InputGain(InputEffect):
    """An actuator whose scale is off: acting = (1 + e) u.

    A motor's constant, an amplifier's gain, a load cell read in the wrong range. Where all that the
    input acts on is free (a mass with its spring and damper) it looks like these, and is not told.
    """

    twins = ("gain",)
    parameters = (Parameter("error", ""),)

    def drive(self, at, u, p):
        """(1 + e) u."""
        (given,) = at.position
        return given + p.error * given

    def remark(self, values, step):
        """Remarks on a scale that no actuator is wrong by."""
        return scale_remark([1 + values["error"]])


class InputOffset(InputEffect):
    """An actuator whose zero is off: acting = u + o.

    A valve that is not quite closed, a gate driver's dead time, a rudder out of trim, a load cell's
    zero. It is tried where the input multiplies a state, or enters several rates; elsewhere a
    constant flow, or force, does the same.
    """

    shifts = True
    parameters = (Parameter("offset", "position"),)

    def drive(self, at, u, p):
        """u + o."""
        (given,) = at.position
        return given + p.offset


class InputDeadZone(InputEffect):
    """An actuator that does not answer small inputs: acting = u - s clip(u, -g, g).

    Valve overlap, play in a linkage, a motor's breakaway voltage (Tao and Kokotovic, Adaptive
    Control of Systems with Actuator and Sensor Nonlinearities, 1996). Corners are rounded over +-w.
    Where the input drives a mass that slides, dry friction looks alike.
    """

    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter("gap", "position", lower=0.0, role="shape", grid=(0.05, 0.15, 0.4)),
        WIDTH,
    )

    def drive(self, at, u, p):
        """u - s clip(u, -g, g)."""
        (given,) = at.position
        return given - p.share * (given - excess_over_gap(given, p.gap, p.width))


class InputSaturation(InputEffect):
    """An actuator that gives no more than its limit: acting = u - s sign(u) (|u| - l)_+.

    Full stroke, a supply's voltage or current. Corners are rounded over +-w.
    """

    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter("limit", "position", lower=0.0, role="shape", grid=(0.4, 0.6, 0.8)),
        WIDTH,
    )

    def drive(self, at, u, p):
        """u - s sign(u) (|u| - l)_+."""
        (given,) = at.position
        return given - p.share * excess_over_gap(given, p.limit, p.width)


class ActuatorLag(InputEffect):
    """An actuator that follows its input late: acting = u - s (u - z), T z' = u - z.

    A first-order drive (a coil, a valve, an amplifier), whole at s = 1. Where T is short against
    the motion all sensors late by T look the same. With s = 2 it is the first
    approximation of an ``input_delay`` of 2 T.
    """

    special = ("input_delay",)
    states = (State("followed", "position", like="position"),)
    twins = ("sensor_lag", "delay")
    whole = {"share": 1.0}
    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter("time_constant", "s", lower=0.0, role="shape", start=0.01, spectrum=True),
    )

    def drive(self, at, u, p):
        """u - s (u - z)."""
        return _partly_followed(at, p)

    def rate(self, at, u, p):
        """(u - z) / T."""
        (given,) = at.position
        return {"followed": (given - at.own.followed) / p.time_constant}

    def limit_values(self, values):
        """A sensor's lag or a delay of s T, by which slow motion is late."""
        return late_by([values["share"] * values["time_constant"]])

    def remark(self, values, step):
        """Remarks on a lag of half a sample, and on a share near 2, which stands for a delay."""
        late = values["share"] * values["time_constant"]
        usual = half_sample_remark(late, step)
        if usual or abs(values["share"] - 2) >= _NEAR_TWO:
            return usual
        return f"a share near 2 is a delay, of {late:.2g} s: input_delay"


class RateLimit(InputEffect):
    """An actuator that moves no faster than R: acting = u - s (u - z), z' = R tanh((u - z) / w).

    A servo valve, a rudder, a stepping drive; whole at s = 1. w is the error at which the limit is
    felt; below it the actuator follows like a lag of w / R.
    """

    special = ("actuator_lag",)
    whole = {"share": 1.0}
    states = (State("followed", "position", like="position"),)
    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter("rate", "velocity", lower=0.0, role="shape", grid=(0.05, 0.15, 0.4)),
        Parameter("width", "position", lower=0.0, role="shape", grid=(0.02, 0.06)),
    )

    def drive(self, at, u, p):
        """u - s (u - z)."""
        return _partly_followed(at, p)

    def rate(self, at, u, p):
        """R tanh((u - z) / w)."""
        (given,) = at.position
        return {"followed": p.rate * tanh((given - at.own.followed) / p.width)}

    def limit_values(self, values):
        """A lag of w / R is what it is below the limit."""
        return {"time_constant": values["width"] / values["rate"]} if values["rate"] else {}


class InputPlay(InputEffect):
    """An actuator with play: acting = u - s (u - z), T z' = what of u - z lies beyond +-g.

    Lash of a gear or a linkage, the stem of a sticking valve: z stays until u has crossed the gap,
    then follows with the time T; whole at s = 1. With a share below one, part of it follows at
    once: the loop of a magnet or a ceramic in straight lines (Krasnosel'skii and Pokrovskii,
    Systems with Hysteresis, 1989). Where its corner is rounded by w, z begins to follow at g - w.
    Without a gap it is ``actuator_lag``.
    """

    special = ("actuator_lag",)
    whole = {"share": 1.0}
    states = (State("followed", "position", like="position"),)
    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter("gap", "position", lower=0.0, role="shape", grid=(0.05, 0.15, 0.4), spread=True),
        WIDTH,
        Parameter("time_constant", "s", lower=0.0, role="shape", grid=(0.02, 0.1)),
    )

    def drive(self, at, u, p):
        """u - s (u - z)."""
        return _partly_followed(at, p)

    def rate(self, at, u, p):
        """What lies beyond the gap, over T."""
        (given,) = at.position
        beyond = excess_over_gap(given - at.own.followed, p.gap, p.width)
        return {"followed": beyond / p.time_constant}


class InputHysteresis(InputEffect):
    """An actuator that hangs behind by where it turned: acting = u - s (h + T h').

    h' = w' - (|w'| h + r w' |h|) / L with T w' = u - w: of each move a share s is held back, until
    the input has gone on in one direction by some L (Bouc, 1967, and Wen, 1976; with r = 0 Dahl,
    1968): a piezo ceramic, a magnet, a diaphragm. What it holds back does not depend on how fast
    the input moves, where this is slower than T; h + T h' is h without the delay of w to the first
    order. r is zero unless the record tells it. With a large L it is ``input_gain``.
    """

    special = ("input_gain",)
    states = (State("followed", "position", like="position"), State("held", "position"))
    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter(
            "length", "position", lower=0.0, role="shape", grid=(0.05, 0.2, 0.6), spread=True
        ),
        Parameter("asymmetry", "", lower=-2.0, upper=2.0, role="shape", start=0.0),
        Parameter("time_constant", "s", lower=0.0, role="shape", grid=(0.1,)),
    )

    def drive(self, at, u, p):
        """u - s (h + T h')."""
        (given,) = at.position
        return given - p.share * (at.own.held + p.time_constant * self._held_rate(at, p))

    def rate(self, at, u, p):
        """w' and h'."""
        return {"followed": self._followed_rate(at, p), "held": self._held_rate(at, p)}

    def _followed_rate(self, at, p):
        (given,) = at.position
        return (given - at.own.followed) / p.time_constant

    def _held_rate(self, at, p):
        rate, held = self._followed_rate(at, p), at.own.held
        return rate - (length([rate]) * held + p.asymmetry * rate * length([held])) / p.length


class InputDelay(DelayedValue, InputEffect):
    """An actuator that acts late by T: acting = u(t - T).

    A bus, a controller's cycle, transport in a pipe. By four states: Pade's second approximation of
    T / 2, twice (Baker, Graves-Morris, Pade Approximants), right in phase to (2 pi f T)^5 / 11520
    at the frequency f. All sensors late by T look the same. A negative T is an input that was
    recorded late.
    """

    twins = ("delay", "sensor_lag")
    parameters = (Parameter("time", "s"), SCALE)

    def drive(self, at, u, p):
        """u(t - T)."""
        return self.late_value(at, p)

    def remark(self, values, step):
        """Remarks on a negative delay, and on one of half a sample."""
        if values["time"] < 0:
            return f"no actuator is early: the input is recorded {-values['time']:.2g} s late"
        return half_sample_remark(values["time"], step)


class InputCoupling(StateFlow):
    """An input that also acts where the model gives it no path: x' = ... + c u, or a force c u.

    Crosstalk of a drive to another axis, an electrode that is not aligned, the sun on a floor, a
    heater that warms its neighbour, a rudder that rolls a ship. It has no delay of its own and no
    threshold. Where the input follows a state (a controller's), it may look like what that state
    does.
    """

    driver = "input"
    parameters = (Parameter("gain", "force/position"),)

    def flow(self, at, u, p):
        """c u."""
        (given,) = at.position
        return [p.gain * given]


class QuadraticInputCoupling(StateFlow):
    """The square of an input that acts where the model gives it no path: x' = ... + c u^2.

    Joule heat of a current, the pull of an electrode or a coil, wind on a mast, drag of a stream:
    what has no sign. Where the input hardly changes it looks like ``input_coupling``.
    """

    driver = "input"
    parameters = (Parameter("gain", "force/position^2"),)

    def flow(self, at, u, p):
        """c u^2."""
        (given,) = at.position
        return [p.gain * given**2]
