"""A ball that rolls on a beam under a known controller: the ball's place is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping

from spiral.math import cos, sin
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class BallAndBeam(MechanicalSystem):
    """7/5 m r'' = m r a'^2 - m g sin a, (J + m r^2) a'' = T - 2 m r r' a' - m g r cos a.

    T = command + k1 r + k2 r' - k3 a - k4 a' + m g r (Hauser, Sastry, Kokotovic, 1992, for the
    plant).
    """

    coordinates = (State("ball", "m"), State("beam", "rad"))
    observed = ("ball",)
    inputs = (Input("command", "N*m", "band_limited"),)
    injections = (State("ball", "N"), State("beam", "N*m"))
    parameters = (
        Parameter("ball_mass", "kg", lower=0.0, start=0.1),
        Parameter("beam_inertia", "kg*m^2", lower=0.0, start=0.02),
        Parameter("gravity", "m/s^2", start=9.81),
        Parameter("gain_place", "N", start=2.926),
        Parameter("gain_speed", "N*s", start=1.536),
        Parameter("gain_angle", "N*m/rad", start=2.854),
        Parameter("gain_rate", "N*m*s/rad", start=0.336),
    )
    ports = (
        Port("ball", ("r",), lambda q, p: [q.ball], "m", "N"),
        Port("beam", ("angle",), lambda q, p: [q.beam], "rad", "N*m"),
    )
    seed = (LinearDamping(), LinearDamping(port="beam"))

    def mass(self, q, p):
        """7/5 m of the rolling ball, kg; beam and ball about the pivot, kg m^2."""
        return [[1.4 * p.ball_mass, 0], [0, p.beam_inertia + p.ball_mass * q.ball**2]]

    def force(self, q, v, u, p):
        """Centrifugal force and weight on the ball, N; the motor's and the ball's moments, N m."""
        weight = p.ball_mass * p.gravity
        torque = (
            u.command + p.gain_place * q.ball + p.gain_speed * v.ball - p.gain_angle * q.beam
            - p.gain_rate * v.beam + weight * q.ball
        )  # fmt: skip
        turning = 2 * p.ball_mass * q.ball * v.ball * v.beam
        return [
            p.ball_mass * q.ball * v.beam**2 - weight * sin(q.beam),
            torque - turning - weight * q.ball * cos(q.beam),
        ]
