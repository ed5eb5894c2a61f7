"""Ports: places where effects act."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from spiral.types.rates import per_second


@dataclass(frozen=True)
class Port:
    """A place on the machine, given by its coordinates as functions of the state.

    ``coordinates(q, p)`` returns one expression per axis. Velocities and generalised forces
    follow by virtual work: v = J q', Q = J^T F with J = d(coordinates)/dq. An effect is written
    once and serves one axis or two, a disk or a bearing. ``against`` is the input or state from
    which the position of a place for flows counts; empty where it counts from zero.
    """

    name: str
    axes: tuple[str, ...]
    coordinates: Callable[[SimpleNamespace, SimpleNamespace], list[Any]]
    position_unit: str
    force_unit: str
    against: str = ""

    def unit(self, relative: str) -> str:
        """A unit relative to the port in absolute words: ``force/position`` -> ``(N)/(m)``."""
        import re

        words = {
            "force": f"({self.force_unit or '1'})",
            "position": f"({self.position_unit or '1'})",
            "velocity": f"({per_second(self.position_unit)})",
        }
        return re.sub(r"\b(force|position|velocity)\b", lambda m: words[m[0]], relative)


@dataclass(frozen=True)
class At:
    """What an effect sees at its port: position and velocity per axis, and its own states.

    A sensor sees its channels and their rates. ``acceleration`` is the rate of these rates, zero
    for a channel whose rate is no state of the system (it would need the inputs' rates), and empty
    where an effect is asked for its leading order alone.
    """

    position: tuple[Any, ...]
    velocity: tuple[Any, ...]
    own: SimpleNamespace
    acceleration: tuple[Any, ...] = ()
