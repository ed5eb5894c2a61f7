"""The library of terms that hidden states of a full system leave in observable equations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from spiral_plugins.effects.restoring import SpeedStiffness
from spiral_plugins.libraries.categories import TABLE, Category, expand_categories
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.types.errors import ConfigError
from spiral.types.library import Library, Term
from spiral.types.system import MechanicalSystem, System

_SECOND = Category(
    "speed stiffness", ((SpeedStiffness, "gyroscopic moment of the hidden tilt, second order"),)
)


class Projection(Library):
    """What is left of hidden states: o'' = P(o, o', W) from M q'' = F, h eliminated (``project``).

    Each term carries the coefficient that elimination predicts for it, and its formula. To order 1
    the paper's rotor gives stiffness, damping, cross-stiffness, the cubic spring, the unbalance and
    the gyroscopic term 1.778 I_p/m; to order 2 ``speed_stiffness`` joins, and the stiffnesses fall
    by the hidden inertia; order 3 corrects the gyroscopic and the damping terms.

    Fields
    ------
    system : the whole machine, with its seed and nominal values.
    values : parameters that differ from its nominal ones, by full name.
    order : time derivatives kept in the hidden states' dynamics, 0 to 3.
    """

    system: System = TiltingRotor()
    values: Mapping[str, float] | None = None
    order: int = 1

    def terms(self, system: System) -> tuple[Term, ...]:
        """Terms whose projected coefficient is not zero, the seed's own included."""
        from spiral.physics.projection import project

        whole = self.system
        if not isinstance(system, MechanicalSystem) or not isinstance(whole, MechanicalSystem):
            raise ConfigError(
                f"library=projection of {whole.plugin_name()!r} onto {system.plugin_name()!r}",
                "two mechanical systems, the second with fewer coordinates",
                "system=planar_rotor library.system=tilting_rotor",
            )
        offered = {t.key: t for t in expand_categories((*TABLE, _SECOND), system)}
        effects = tuple({t.effect.label: t.effect for t in offered.values()}.values())
        values = {**whole.defaults, **(self.values or {})}
        projected = project(whole, values, self.order, system, effects)
        return tuple(
            replace(
                offered[p.key], predicted=p.value, mechanism=_describe_mechanism(offered[p.key], p)
            )
            for p in projected
        )


def _describe_mechanism(term: Term, projected) -> str:
    """The mechanism, its formula, and which share of it passes through the hidden states."""
    through = projected.value - projected.direct
    text = f"{term.mechanism}: {projected.formula}"
    if abs(through) <= 1e-9 * abs(projected.value):
        return f"{text}, direct"
    if projected.direct == 0:
        return f"{text}, through the hidden states alone"
    return f"{text}, {projected.direct:.4g} direct and {through:.4g} through the hidden states"
