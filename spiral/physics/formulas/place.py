"""Places: what a formula may name at a port of a system, with units."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from spiral.types.rates import per_second
from spiral.types.system import System, has_coordinates

_RELATIVE = r"\b(force|position|velocity)\b"
EACH_AXIS = ("q", "v")
"""Position and velocity of the axis at hand, where the system has no other use for the name."""
AXIS_AT_HAND = ("axis_position", "axis_velocity")
"""The same in full, in any system."""


@dataclass(frozen=True)
class Place:
    """What a formula may name at a port of a system, with units.

    ``outputs`` are the axes of the port or the channels of flows, each with the unit of its value.
    """

    system: str
    port: str
    force: bool
    outputs: tuple[tuple[str, str], ...]
    positions: tuple[tuple[str, str], ...]
    states: tuple[tuple[str, str], ...]
    inputs: tuple[tuple[str, str], ...]
    position_unit: str
    force_unit: str

    @property
    def known(self) -> dict[str, str]:
        """Name -> unit of everything that is no parameter."""
        rates = {f"{n}_rate": per_second(u) for n, u in self.positions}
        units = (self.position_unit, per_second(self.position_unit))
        own = {**dict(self.positions), **rates} if self.force else dict(self.states)
        own |= dict(self.inputs)
        each = values_at_hand(*units) if self.force else {}
        return own | {n: unit for n, unit in each.items() if n not in own}

    @property
    def at_hand(self) -> tuple[str, ...]:
        """Names of the position and velocity of the axis at hand, the short ones where free."""
        taken = {*dict(self.positions), *dict(self.inputs)}
        pairs = zip(EACH_AXIS, AXIS_AT_HAND, strict=True)
        return tuple(full if short in taken else short for short, full in pairs)

    def is_for_all_axes(self, names: Iterable[str]) -> bool:
        """Whether a formula with these names speaks of the axis at hand."""
        return self.force and not {*self.at_hand, *AXIS_AT_HAND}.isdisjoint(names)

    @property
    def words(self) -> dict[str, str]:
        """Words for units in order of preference."""
        others = self.inputs if self.force else (*self.states, *self.inputs)
        more = dict.fromkeys(u for _, u in others if u)
        return {"force": self.force_unit, "position": self.position_unit, "s": "s"} | {
            u: u for u in more
        }

    def absolute(self, relative: str) -> str:
        """A unit in the place's words (``force/position``) in absolute ones: ``(N)/(m)``."""
        words = {**self.words, "velocity": per_second(self.position_unit)}
        return re.sub(_RELATIVE, lambda m: f"({words[m[0]] or '1'})", relative)

    def is_relative(self, unit: str) -> bool:
        """Whether a unit is in the place's words."""
        return bool(re.search(_RELATIVE, unit))


def values_at_hand(position: Any, velocity: Any) -> dict[str, Any]:
    """What stands for an axis at hand in a formula; names of the system come before these."""
    return {
        name: value
        for names in (EACH_AXIS, AXIS_AT_HAND)
        for name, value in zip(names, (position, velocity), strict=True)
    }


def place_of(system: System, port: str = "") -> Place:
    """What a formula may name at a port of a system."""
    at = system.port(port)
    inputs = [(i.name, i.unit) for i in system.inputs]
    inputs += [(i.rate.name, i.rate.unit) for i in system.inputs if i.derivative]
    force = has_coordinates(system)
    axes = tuple((axis, at.force_unit) for axis in at.axes)
    flows = tuple((i.name, i.unit) for i in system.injections)
    return Place(
        system=system.plugin_name(),
        port=at.name,
        force=force,
        outputs=axes if force else flows,
        positions=tuple((axis, at.position_unit) for axis in at.axes),
        states=tuple((s.name, s.unit) for s in system.states),
        inputs=tuple(inputs),
        position_unit=at.position_unit,
        force_unit=at.force_unit,
    )
