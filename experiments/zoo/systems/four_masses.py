"""Four masses on springs, as a user would write them: sensors on the first and the third."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem

_LINKS = ("link_12", "link_23", "link_34")


class FourMasses(MechanicalSystem):
    """M q'' = force - K q - C q': a spring and a damper to ground and between neighbours."""

    coordinates = tuple(State(f"x{i}", "m") for i in (1, 2, 3, 4))
    observed = ("x1", "x3")
    inputs = (Input("force", "N", "band_limited"),)
    injections = tuple(State(f"x{i}", "N") for i in (1, 2, 3, 4))
    parameters = (Parameter("mass", "kg", lower=0.0, start=1.0),)
    ports = (
        Port("ground", ("x",), lambda q, p: [q.x1], "m", "N"),
        Port("link_12", ("x",), lambda q, p: [q.x2 - q.x1], "m", "N"),
        Port("link_23", ("x",), lambda q, p: [q.x3 - q.x2], "m", "N"),
        Port("link_34", ("x",), lambda q, p: [q.x4 - q.x3], "m", "N"),
    )
    seed = (
        LinearStiffness(),
        LinearDamping(),
        *(LinearStiffness(port=k) for k in _LINKS),
        *(LinearDamping(port=k) for k in _LINKS),
    )

    def mass(self, q, p):
        """m times the identity, kg."""
        return [[p.mass if i == j else 0 for j in range(4)] for i in range(4)]

    def force(self, q, v, u, p):
        """The force on the first mass, N."""
        return [u.force, 0, 0, 0]
