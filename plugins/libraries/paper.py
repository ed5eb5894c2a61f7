"""The library of the paper's table."""

from __future__ import annotations

from spiral_plugins.libraries.categories import TABLE, expand_categories

from spiral.types.library import Library, Term
from spiral.types.system import System


class Paper(Library):
    """The paper's table (CandidateLibrary): a = sum_l theta_l phi_l, eleven categories.

    1; x, y, x', y'; their ten products; W x, W y; W x', W y'; |q|^2 q; |q|^2 q';
    W^2 cos t, W^2 sin t; and the network's own residual as the last resort (``closure``). Every
    basis function may act in every equation; the two coefficients of a pair (W y' in x, W x' in y)
    are written as the named effect they make together and what is left of it, which spans the same.
    """

    closure = True

    def terms(self, system: System) -> tuple[Term, ...]:
        """44 terms beside the seed's six for a planar rotor; fewer for one axis."""
        return expand_categories(TABLE, system)
