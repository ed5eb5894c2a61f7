"""The short-period pitching of a glider: the pitch rate is measured, the incidence is hidden."""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class Lift(FlowEffect):
    """Lift turns the path: a' = -Z a."""

    channels = ("incidence",)
    parameters = (Parameter("slope", "1/s"),)

    def flow(self, x, u, p):
        """-Z a."""
        return {"incidence": -p.slope * x.incidence}


class PitchMoment(FlowEffect):
    """Static stability, pitch damping and the elevator: q' = -M_a a - M_q q - M_d d."""

    channels = ("incidence", "pitch_rate", "elevator_angle")
    parameters = (
        Parameter("stability", "1/s^2"),
        Parameter("damping", "1/s"),
        Parameter("elevator", "1/s^2"),
    )

    def flow(self, x, u, p):
        """-M_a a - M_q q - M_d d."""
        return {
            "pitch_rate": -p.stability * x.incidence
            - p.damping * x.pitch_rate
            - p.elevator * x.elevator_angle
        }


class ElevatorServo(FlowEffect):
    """The servo follows its command: d' = (c - d) / T, as a rate 1 / T."""

    channels = ("elevator_angle",)
    inputs = ("stick",)
    parameters = (Parameter("bandwidth", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """(c - d) / T."""
        return {"elevator_angle": p.bandwidth * (u.stick - x.elevator_angle)}


class LiftBreak(FlowEffect):
    """Lift that gives way at large incidence: a' = + Z3 a^3."""

    channels = ("incidence",)
    parameters = (Parameter("loss", "1/s/rad^2"),)

    def flow(self, x, u, p):
        """Z3 a^3."""
        return {"incidence": p.loss * x.incidence**3}


class PitchUp(FlowEffect):
    """Stability that changes with incidence: q' = M3 a^3."""

    channels = ("incidence", "pitch_rate")
    parameters = (Parameter("moment", "1/s^2/rad^2"),)

    def flow(self, x, u, p):
        """M3 a^3."""
        return {"pitch_rate": p.moment * x.incidence**3}


class TrimOffset(FlowEffect):
    """A glider out of trim: q' = m0."""

    channels = ("pitch_rate",)
    parameters = (Parameter("moment", "rad/s^2"),)

    def flow(self, x, u, p):
        """m0."""
        return {"pitch_rate": p.moment}


class Glider(System):
    """a' = q - Z a, q' = -M_a a - M_q q - M_d d, d' = (stick - d) / T.

    The short-period approximation (Etkin, Reid, Dynamics of Flight, ch. 6).
    """

    states = (
        State("incidence", "rad"),
        State("pitch_rate", "rad/s"),
        State("elevator_angle", "rad"),
    )
    observed = ("pitch_rate",)
    inputs = (Input("stick", "rad", "zero_order"),)
    injections = (
        State("incidence", "rad/s"),
        State("pitch_rate", "rad/s^2"),
        State("elevator_angle", "rad/s"),
    )
    parameters = ()
    ports = (Port("gyro", ("rate",), lambda x, p: [x.pitch_rate], "rad/s", "rad/s^2"),)
    seed = (Lift(), PitchMoment(), ElevatorServo())

    def rate(self, x, u, p, injected):
        """Pitching turns the wing into the flow."""
        return {**injected, "incidence": x.pitch_rate + injected["incidence"]}
