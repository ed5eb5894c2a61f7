"""A chain of masses on equal springs and dampers, its ends measured, a port at every link."""

from __future__ import annotations

from experiments.zoo.systems.mass_chain import MassChain, stretch
from spiral.types.parameter import Parameter
from spiral.types.port import Port


class Chain(MassChain):
    """m x_i'' = k (x_{i-1} - 2 x_i + x_{i+1}) + c (same of rates), x1 on a mount, driven there.

    Fields
    ------
    masses : how many, from one on.
    """

    masses: int = 3

    parameters = (
        Parameter("mass", "kg", lower=0.0, start=0.5),
        Parameter("stiffness", "N/m", lower=0.0, start=4000.0),
        Parameter("damping", "N*s/m", lower=0.0, start=2.0),
    )

    @property
    def observed(self):
        """First and last."""
        return tuple(dict.fromkeys(("x1", f"x{self.masses}")))

    @property
    def ports(self):
        """The mount and the links, counted by their first mass."""
        links = (
            Port(f"link{i}", ("x",), lambda q, p, i=i: [stretch(q, i)], "m", "N")
            for i in range(1, self.masses)
        )
        return (Port("mount", ("x",), lambda q, p: [q.x1], "m", "N"), *links)
