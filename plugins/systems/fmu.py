"""A model from another program: an FMU for model exchange."""

from __future__ import annotations

from typing import Any, ClassVar

from spiral_plugins.systems.function import Function
from spiral_plugins.systems.outside import Outside

from spiral.types.errors import ConfigError, InputError


class Fmu(Outside):
    """x' = f(t, x, u, p) of an FMU (2.0 or 3.0); forces act through inputs that are named for it.

    An FMU is a program, and it is run: where a command or a call names its file, and nowhere else.

    Fields
    ------
    path : the file; left out, a mass on a spring.
    forces : coordinate -> the input of the FMU that a force on it goes through; left out, forces
        act per unit mass on every coordinate.
    recorded : inputs that a record has; left out, all that no force goes through.
    measured : states, or outputs that are a state; left out, all such outputs.
    free : parameters (tunable ones of the FMU) that the fit moves.
    sha256 : of the file that is meant; left out, the file as it is.
    """

    program: ClassVar[str] = "path"

    path: str = ""
    forces: Any = ()
    recorded: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    sha256: str = ""

    def __post_init__(self):
        """Read and start the FMU, so that what is wrong is said at once."""
        object.__setattr__(self, "forces", _force_pairs(self.forces))
        if not self.path:
            return
        from spiral.io.readers.fmu import file_sha256

        file_hash = file_sha256(self.path)
        if self.sha256 not in ("", file_hash):
            raise InputError(
                f"FMU {self.path!r} with SHA-256 {file_hash[:12]}",
                f"the file with SHA-256 {self.sha256[:12]}",
                f"system.sha256={file_hash} to take the file as it is now",
            )
        object.__setattr__(self, "sha256", file_hash)
        _ = self.ports

    @property
    def wrapped(self):
        """The FMU, opened in this process."""
        if not self.path:
            return Function().wrapped
        from spiral.io.readers.fmu_system import wrap_fmu

        return wrap_fmu(
            self.path, self.sha256, self.forces, self.recorded, self.measured, self.free
        )


def _force_pairs(given):
    """Coordinate and input, in the order given."""
    try:
        pairs = given.items() if hasattr(given, "items") else (given or ())
        return tuple((str(a), str(b)) for a, b in pairs)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"system.forces={given!r}", "coordinate: input", "system.forces='{x: F}'"
        ) from error
