"""Named laws of one variable, as formulas: what a force or a flow may follow that is in no catalog.

Each is an effect by expression (``spiral.physics.formulas.expression``): linear in its amplitudes,
its other parameters tried at shares of the motion. q is the position at a port, v its rate, s the
state that a flow goes into.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from spiral.physics.formulas.expression import class_of
from spiral.physics.formulas.place import AXIS_AT_HAND, EACH_AXIS
from spiral.types.cache import kept
from spiral.types.effect import Effect
from spiral.types.placement import at_every_place, fits
from spiral.types.system import System, has_coordinates


@dataclass(frozen=True)
class Law:
    """A formula with the values at which its shapes are tried.

    ``grid`` : shape -> values, as shares of the largest motion where ``units`` says position or
    velocity, else as they are.
    """

    name: str
    meaning: str
    formula: str
    grid: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    lower: Mapping[str, float] = field(default_factory=dict)

    def as_definition(self, formula: object, port: str = "") -> dict[str, object]:
        """As an effect by expression is given (``expression.Definition``)."""
        entries = {"expression": formula, "grid": dict(self.grid), "units": dict(self.units),
                 "lower": dict(self.lower), "meaning": self.meaning, "port": port}  # fmt: skip
        return {k: v for k, v in entries.items() if v}

    def rename_taken_letters(self, taken: Container[str]) -> Law:
        """The law with other letters where its own are names already."""
        new = {n: n if n not in taken else f"{n}_law" for n in ("a", "b", "c", "l", "n", "K")}
        axis = zip(EACH_AXIS, AXIS_AT_HAND, strict=True)
        new |= {short: full if short in taken else short for short, full in axis}

        def rename_keys(given: Mapping[str, Any]) -> dict[str, Any]:
            return {new[k]: v for k, v in given.items()}

        return replace(
            self,
            formula=re.sub(r"\b[abclnKqv]\b", lambda m: new[m.group()], self.formula),
            grid=rename_keys(self.grid),
            units=rename_keys(self.units),
            lower=rename_keys(self.lower),
        )


_POWER = "exp({n}*log(hypot({z}, 0.01)))"
"""|z|^n, its corner at zero rounded over a hundredth, where a slope by n would be infinite."""


def _power_formula(z: str, n: str = "n") -> str:
    return _POWER.format(z=z, n=n)


_PLACE, _RATE = {"l": "position"}, {"l": "velocity"}
_SIDES = (1.2, 1.6, 3.0, -1.2, -1.6, -3.0)

SPRINGS = (
    Law(
        "sine_law",
        "A force that comes round again with displacement",
        "a*sin(q/l) + b*(cos(q/l) - 1)",
        {"l": (0.07, 0.11, 0.17, 0.26, 0.4, 0.6)},
        _PLACE,
        {"l": 0.0},
    ),
    Law(
        "tanh_law",
        "A spring that saturates smoothly",
        "-a*tanh(q/l)",
        {"l": (0.06, 0.2, 0.5)},
        _PLACE,
        {"l": 0.0},
    ),
    Law(
        "exponential_law",
        "A force that grows exponentially to one side",
        "a*(exp(q/l) - 1)",
        {"l": (-0.7, -0.25, 0.25, 0.7)},
        _PLACE,
    ),
    Law(
        "power_law",
        "A force that grows with a power of displacement",
        f"-a*(q/l)/hypot(q/l, 0.01)*{_power_formula('q/l')}",
        {"n": (0.5, 1.5, 2.5, 4.0), "l": (1.0,)},
        _PLACE,
        {"n": 0.0},
    ),
    Law(
        "dead_zone_law",
        "A spring of another stiffness beyond a gap",
        "-a*(maximum(q - l, 0) - maximum(-q - l, 0))",
        {"l": (0.1, 0.25, 0.45, 0.7)},
        _PLACE,
        {"l": 0.0},
    ),
    Law(
        "one_sided_law",
        "A spring of another stiffness beyond one point",
        "-a*maximum(q - l, 0)",
        {"l": (-0.6, -0.3, 0.0, 0.3, 0.6)},
        _PLACE,
    ),
    Law(
        "saturation_law",
        "A spring that yields no more than its limit",
        "-a*(q - maximum(q - l, 0) + maximum(-q - l, 0))",
        {"l": (0.1, 0.25, 0.45, 0.7)},
        _PLACE,
        {"l": 0.0},
    ),
    Law(
        "inverse_square_law",
        "A force that falls with the square of a distance",
        "a*(1/((1 - q/l)*(1 - q/l)) - 1)",
        {"l": _SIDES},
        _PLACE,
    ),
    Law(
        "peak_law",
        "A spring whose force falls again beyond a displacement (a magnet that lets go)",
        "-2*a*(q/l)/(1 + (q/l)*(q/l))",
        {"l": (0.1, 0.25, 0.6)},
        _PLACE,
        {"l": 0.0},
    ),
    Law("polynomial_law", "A force that is a polynomial of displacement", "a*q**2 + b*q**3"),
    Law("quintic_law", "An odd polynomial of displacement", "a*q**3 + b*q**5"),
)
FRICTIONS = (
    Law(
        "tanh_friction_law",
        "Friction that does not grow beyond its level",
        "-a*tanh(v/l)",
        {"l": (0.005, 0.03, 0.15, 0.5)},
        _RATE,
        {"a": 0.0, "l": 0.0},
    ),
    Law(
        "stribeck_law",
        "Dry friction that falls from rest to sliding",
        "-(a + b*exp(-(v/c)*(v/c)))*tanh(v/l)",
        {"c": (0.03, 0.1, 0.3), "l": (0.005, 0.02)},
        {"l": "velocity", "c": "velocity"},
        {"a": 0.0, "b": 0.0, "c": 0.0, "l": 0.0},
    ),
    Law(
        "power_friction_law",
        "A damper whose force grows with a power of the rate",
        f"-a*(v/l)/hypot(v/l, 0.01)*{_power_formula('v/l')}",
        {"n": (0.5, 1.5, 2.5, 4.0), "l": (1.0,)},
        _RATE,
        {"n": 0.0},
    ),
    Law(
        "peak_friction_law",
        "A damper whose force falls again beyond a rate (an eddy-current brake)",
        "-2*a*(v/l)/(1 + (v/l)*(v/l))",
        {"l": (0.1, 0.25, 0.6)},
        _RATE,
        {"l": 0.0},
    ),
    Law("polynomial_friction_law", "A polynomial of the rate", "-a*v*abs(v) - b*v**3"),
)
_HALF = {"K": "position"}
FLOWS = (
    Law(
        "hill_law",
        "A loss that sets in and saturates (Hill)",
        f"-a*{_power_formula('s/K')}/(1 + {_power_formula('s/K')})",
        {"n": (2.0, 4.0), "K": (0.15, 0.35, 0.7)},
        _HALF,
        {"a": 0.0, "n": 0.0, "K": 0.0},
    ),
    Law(
        "power_loss_law",
        "A loss that grows with a power of what is there",
        f"-a*(s/K)/hypot(s/K, 0.01)*{_power_formula('s/K')}",
        {"n": (0.5, 1.5, 2.5, 4.0), "K": (1.0,)},
        _HALF,
        {"n": 0.0},
    ),
    Law(
        "exponential_loss_law",
        "A loss that grows exponentially",
        "-a*(exp(s/K) - 1)",
        {"K": (0.15, 0.5, -0.5)},
        _HALF,
    ),
    Law(
        "sine_loss_law",
        "A flow that comes round again",
        "a*sin(s/K) + b*(cos(s/K) - 1)",
        {"K": (0.1, 0.2, 0.4)},
        _HALF,
        {"K": 0.0},
    ),
    Law(
        "overflow_law",
        "A loss that sets in at a level",
        "-a*maximum(s - K, 0)",
        {"K": (0.2, 0.5, 0.75)},
        _HALF,
    ),
    Law(
        "peak_loss_law",
        "A loss that falls again beyond a level (Kloss's motor, Haldane's inhibition)",
        "-2*a*(s/K)/(1 + (s/K)*(s/K))",
        {"K": (0.1, 0.25, 0.6)},
        _HALF,
        {"K": 0.0},
    ),
    Law(
        "inverse_loss_law",
        "A flow that falls with what is there",
        "a/(1 + s/K)",
        {"K": (0.1, 0.4)},
        _HALF,
        {"K": 0.0},
    ),
)


def law_names() -> tuple[str, ...]:
    """All laws by name, those of springs, of friction and of losses."""
    return tuple(law.name for law in (*SPRINGS, *FRICTIONS, *FLOWS))


def law_meaning(effect: Effect) -> str:
    """What a law of this module is, in words within a sentence; empty for any other effect."""
    name = effect.plugin_name()
    for law in (*SPRINGS, *FRICTIONS, *FLOWS):
        if name == law.name or name.startswith(f"{law.name}_"):
            words = law.meaning.partition(" (")[0]
            return words[:1].lower() + words[1:]
    return ""


@kept(16)
def laws_of(system: System) -> tuple[Effect, ...]:
    """Every law at every place of a system where its units fit."""
    made = _force_effects(system) if has_coordinates(system) else _flow_effects(system)
    return tuple(effect for effect in made if fits(system, effect))


def _laws_for_system(system: System, laws: tuple[Law, ...]) -> list[Law]:
    """Laws none of whose letters is a name of the system."""
    named = (*system.states, *system.inputs, *system.parameters)
    taken = {*(n.name for n in named), *(a for port in system.ports for a in port.axes)}
    return [law.rename_taken_letters(taken) for law in laws]


def _force_effects(system: System) -> list[Effect]:
    laws = _laws_for_system(system, (*SPRINGS, *FRICTIONS))
    made = [class_of(law.name, law.as_definition(law.formula), system)() for law in laws]
    return [copy for effect in made for copy in at_every_place(system, effect)]


def _flow_effects(system: System) -> list[Effect]:
    """A flow names its state, so each state has a class of its own."""
    into = {i.name for i in system.injections}
    ports = [p for p in system.ports if len(p.axes) == 1 and p.axes[0] in into]
    effects = []
    for port in ports:
        for law in _laws_for_system(system, FLOWS):
            (name,) = port.axes
            formula = {name: law.formula.replace("s/", f"{name}/").replace("(s ", f"({name} ")}
            made = class_of(f"{law.name}_{name}", law.as_definition(formula, port.name), system)
            effects.append(made())
    return effects
