"""The rotor of the paper: a disk that moves sideways and tilts, on two bearings."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import CrossDamping, LinearDamping
from spiral_plugins.effects.restoring import CrossStiffness, CubicStiffness, LinearStiffness
from spiral_plugins.effects.rotating import Unbalance
from spiral_plugins.systems.rotor import ROTOR_INPUTS, turn_phase

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem

# Paper, appendix: both bearings have 1.6 times the target translational matrices, and the cubic
# stiffness of each is 1e11 / (0.75^4 + 0.25^4).
_BEARING = {
    "linear_stiffness@{0}.stiffness_x": 1.6 * 11622.4461,
    "linear_stiffness@{0}.stiffness_y": 1.6 * 13903.8052,
    "cross_stiffness@{0}.stiffness": 1.6 * 1589.0063,
    "linear_damping@{0}.damping_x": 1.6 * 5.0,
    "linear_damping@{0}.damping_y": 1.6 * 3.0,
    "cross_damping@{0}.damping": 1.6 * 0.1,
    "cubic_stiffness@{0}.stiffness": 1e11 / (0.75**4 + 0.25**4),
}


def _bearing_1(q, p):
    """r_1 = (1 - xi) (x + xi L beta, y - xi L alpha) (paper, eq. Li_rotor)."""
    arm = p.location * p.span
    share = 1 - p.location
    return [share * (q.x + arm * q.beta), share * (q.y - arm * q.alpha)]


def _bearing_2(q, p):
    """r_2 = xi (x - (1 - xi) L beta, y + (1 - xi) L alpha)."""
    arm = (1 - p.location) * p.span
    share = p.location
    return [share * (q.x - arm * q.beta), share * (q.y + arm * q.alpha)]


class TiltingRotor(MechanicalSystem):
    """M q'' + (C + W G) q' + K q + f_NL(q) = f_u: a rotor on two bearings, its tilts hidden.

    The paper's 4-DOF rotor in SI units (eq. full_rotor, values of its appendix).
    """

    @property
    def coordinates(self):
        """Displacements x, y and tilts alpha (about x), beta (about y)."""
        return (State("x", "m"), State("y", "m"), State("alpha", "rad"), State("beta", "rad"))

    @property
    def injections(self):
        """Forces and moments."""
        return (State("x", "N"), State("y", "N"), State("alpha", "N*m"), State("beta", "N*m"))

    @property
    def observed(self):
        """The displacements only."""
        return ("x", "y")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Speed, and phase where it is measured."""
        return ROTOR_INPUTS

    @property
    def parameters(self):
        """Inertias and geometry (paper, table sim_params)."""
        return (
            Parameter("phase_origin", "rad", start=0.0, scope="record"),
            Parameter("mass", "kg", lower=0.0, start=1.15),
            Parameter("diametral_inertia", "kg*m^2", lower=0.0, start=1.5532e-3),
            Parameter("polar_inertia", "kg*m^2", lower=0.0, start=3.1063e-3),
            Parameter("span", "m", lower=0.0, start=1.0),
            Parameter("location", "", lower=0.0, upper=1.0, start=0.25),
        )

    @property
    def ports(self):
        """The disk and the two bearings."""
        axes = ("x", "y")
        return (
            Port("disk", axes, lambda q, p: [q.x, q.y], "m", "N"),
            Port("bearing_1", axes, _bearing_1, "m", "N"),
            Port("bearing_2", axes, _bearing_2, "m", "N"),
        )

    @property
    def seed(self):
        """Springs (linear, cross, cubic) and dampers at both bearings, unbalance at the disk."""
        kinds = (LinearStiffness, CrossStiffness, LinearDamping, CrossDamping, CubicStiffness)
        at_bearings = tuple(kind(port=f"bearing_{i}") for i in (1, 2) for kind in kinds)
        return (*at_bearings, Unbalance())

    @property
    def defaults(self):
        """The paper's appendix and table, SI."""
        values = {k.format(b): v for b in ("bearing_1", "bearing_2") for k, v in _BEARING.items()}
        return {**values, "unbalance.moment": 1.8e-5, "system.phase_origin": 0.4}

    def seen(self, u, p):
        """Effects see the phase turned by the record's origin."""
        return turn_phase(u, p)

    def mass(self, q, p):
        """diag(m, m, I_d, I_d)."""
        m, i = p.mass, p.diametral_inertia
        return [[m, 0, 0, 0], [0, m, 0, 0], [0, 0, i, 0], [0, 0, 0, i]]

    def force(self, q, v, u, p):
        """-W G q': gyroscopic moments -W I_p (beta', -alpha') on the tilts."""
        moment = u.speed * p.polar_inertia
        return [0, 0, -moment * v.beta, moment * v.alpha]
