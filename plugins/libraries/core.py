"""The six candidates of the paper's test of identifiability."""

from __future__ import annotations

from spiral_plugins.libraries.categories import DUFFING, GYROSCOPIC, LINEAR, expand_categories

from spiral.types.library import Library, Term
from spiral.types.system import System

_SIX = (
    "cross_stiffness.stiffness",
    "cross_coupled_stiffness.stiffness",
    "gyroscopic.coefficient",
    "speed_damping.symmetric",
    "cubic_stiffness.stiffness",
    "uneven_cubic.difference",
)


class Core(Library):
    """The paper's six candidates: W y' and W x', |q|^2 x and |q|^2 y, y in x = f, x in y = f.

    Each pair, with a coefficient per equation, is written as its named effect (``gyroscopic``,
    ``cubic_stiffness``, ``cross_stiffness``) and the difference of the two equations.
    Source: Sect. on identifiability at the test rig.
    """

    def terms(self, system: System) -> tuple[Term, ...]:
        """Six terms for a planar rotor; the cubic spring alone for one axis."""
        offered = expand_categories((LINEAR, GYROSCOPIC, DUFFING), system)
        return tuple(t for t in offered if t.key in _SIX)
