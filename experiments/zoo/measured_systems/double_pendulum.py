"""A double pendulum with a motor in each joint: both angles are measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping

from spiral.math import cos, sin
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class DoublePendulum(MechanicalSystem):
    """M(q) q'' + C(q, q') q' = G(q) + torques, angles from hanging, the second one relative.

    With the gears' rotors, as in the DFKI double pendulum's model; the numbers are its design A.0's
    (identified_A0_model_2.0.yml).
    """

    coordinates = (State("shoulder", "rad"), State("elbow", "rad"))
    observed = ("shoulder", "elbow")
    inputs = (
        Input("shoulder_torque", "N*m", "zero_order"),
        Input("elbow_torque", "N*m", "zero_order"),
    )
    injections = (State("shoulder", "N*m"), State("elbow", "N*m"))
    parameters = (
        Parameter("first_mass", "kg", lower=0.0, start=0.5594),
        Parameter("second_mass", "kg", lower=0.0, start=0.6043),
        Parameter("first_centre", "m", lower=0.0, start=0.3),
        Parameter("second_centre", "m", lower=0.0, start=0.1838),
        Parameter("length", "m", lower=0.0, start=0.3),
        Parameter("first_inertia", "kg*m^2", lower=0.0, start=0.05347),
        Parameter("second_inertia", "kg*m^2", lower=0.0, start=0.02392),
        Parameter("rotor_inertia", "kg*m^2", lower=0.0, start=7.66e-5),
        Parameter("gear", "", lower=0.0, start=6.0),
        Parameter("gravity", "m/s^2", lower=0.0, start=9.81),
    )
    ports = (
        Port("shoulder", ("angle",), lambda q, p: [q.shoulder], "rad", "N*m"),
        Port("elbow", ("angle",), lambda q, p: [q.elbow], "rad", "N*m"),
    )
    seed = (LinearDamping(), LinearDamping(port="elbow"))

    def mass(self, q, p):
        """Inertia of both arms and of both motors' rotors, kg m^2."""
        coupling = p.second_mass * p.length * p.second_centre * cos(q.elbow)
        rotor, geared = p.rotor_inertia, p.gear**2 * p.rotor_inertia
        arms = p.first_inertia + p.second_inertia + p.second_mass * p.length**2
        across = p.second_inertia + coupling - p.gear * rotor
        return [
            [arms + 2 * coupling + geared + rotor, across],
            [across, p.second_inertia + geared],
        ]

    def force(self, q, v, u, p):
        """Torques, centrifugal moments and weight, N m."""
        turning = p.second_mass * p.length * p.second_centre * sin(q.elbow)
        lower = p.second_mass * p.second_centre * sin(q.shoulder + q.elbow)
        upper = (p.first_mass * p.first_centre + p.second_mass * p.length) * sin(q.shoulder)
        return [
            u.shoulder_torque
            + turning * (2 * v.shoulder * v.elbow + v.elbow**2)
            - p.gravity * (upper + lower),
            u.elbow_torque - turning * v.shoulder**2 - p.gravity * lower,
        ]
