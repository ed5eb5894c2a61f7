"""Which column of a file is what, and how its numbers become those of a system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from spiral.types.record import Array


@dataclass(frozen=True)
class ColumnLayout:
    """Name -> the file's column, its unit, way to the system's unit, and reading at rest.

    ``conversion`` is factor and zero: a value x of the file is factor x + zero in the system.

    ``constant`` are inputs that have no column but one value throughout, in the system's unit.
    """

    channels: Mapping[str, str]
    inputs: Mapping[str, str]
    clock: Mapping[str, str]
    pulse: Mapping[str, str]
    units: Mapping[str, str]
    conversion: Mapping[str, tuple[float, float]]
    offset: Mapping[str, float]
    constant: Mapping[str, float]

    def options(self) -> dict[str, str]:
        """Option, as messages call it -> column, for all columns in use."""
        return {
            **{f"record.channels {k}": c for k, c in self.channels.items()},
            **{f"record.inputs {k}": c for k, c in self.inputs.items()},
            **{f"record.{k}": c for k, c in (*self.clock.items(), *self.pulse.items())},
        }

    def converted(self, name: str, values: Array) -> Array:
        """A column's values in the system's unit, without what the instrument reads at rest."""
        factor, zero = self.conversion.get(name, (1.0, 0.0))
        return factor * (values - self.offset.get(name, 0.0)) + zero
