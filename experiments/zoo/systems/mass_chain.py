"""A chain of equal masses on equal springs: sensors on the first, the middle and the last."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class MassChain(MechanicalSystem):
    """m x_i'' = k (x_{i-1} - 2 x_i + x_{i+1}) + c (same of rates), the first one on a mount.

    Fields
    ------
    masses : how many.
    """

    masses: int = 8

    inputs = (Input("force", "N", "band_limited"),)
    parameters = (
        Parameter("mass", "kg", lower=0.0, start=0.5),
        Parameter("stiffness", "N/m", lower=0.0, start=4000.0),
        Parameter("damping", "N*s/m", lower=0.0, start=1.0),
    )
    seed = (LinearStiffness(), LinearDamping())  # the mount

    @property
    def coordinates(self):
        """x1 to xn."""
        return tuple(State(f"x{i + 1}", "m") for i in range(self.masses))

    @property
    def observed(self):
        """First, middle and last."""
        return ("x1", f"x{self.masses // 2}", f"x{self.masses}")

    @property
    def injections(self):
        """A force on each mass."""
        return tuple(State(f"x{i + 1}", "N") for i in range(self.masses))

    @property
    def ports(self):
        """The mount, the link in the middle, and the last link."""
        half, last = self.masses // 2, self.masses
        return (
            Port("mount", ("x",), lambda q, p: [q.x1], "m", "N"),
            Port("middle", ("x",), lambda q, p: [stretch(q, half)], "m", "N"),
            Port("end", ("x",), lambda q, p: [stretch(q, last - 1)], "m", "N"),
        )

    def mass(self, q, p):
        """m times the identity, kg."""
        count = range(self.masses)
        return [[p.mass if i == j else 0 for j in count] for i in count]

    def force(self, q, v, u, p):
        """The links' forces on each mass, and the applied force on the first, N."""
        pull = [
            p.stiffness * stretch(q, i) + p.damping * stretch(v, i) for i in range(1, self.masses)
        ]
        return [a - b for a, b in zip([*pull, 0], [-u.force, *pull], strict=True)]


def stretch(q, i):
    """x_{i+1} - x_i."""
    return getattr(q, f"x{i + 1}") - getattr(q, f"x{i}")
