"""A right-hand side in Python that cannot be traced, called as compiled code."""

from __future__ import annotations

from typing import Any

from spiral_plugins.systems.outside import Outside

from spiral.types.errors import ConfigError

EXAMPLE = """\
states: {x: m, v: m/s}
inputs: {F: {unit: N, interpolation: band_limited}}
parameters: {m: 1.0 kg, c: 4.0 N*s/m, k: 4000 N/m}
free: [c, k]
observed: [x]
mass: {x: m}
"""


class Function(Outside):
    """x' = f(t, x, u, p) by a function of Python, compiled by Numba, its slopes by differences.

    Fields
    ------
    function : rhs(t, x, u, p), as spiral.system takes it; left out, a mass on a spring.
    text : the other sections of equations (docs/how-to/own-model.md), in YAML.
    """

    function: Any = None
    text: str = ""

    def __post_init__(self):
        """Compile, so that what is wrong is said at once."""
        if self.function is None and not self.text:
            object.__setattr__(self, "function", _example)
            object.__setattr__(self, "text", EXAMPLE)
        if not callable(self.function):
            raise ConfigError(
                f"a system that is the function {self.function or ''!s}".rstrip(),
                "the function itself, which no file holds",
                "spiral.system(rhs, states=..., ...) in Python, and discover again",
            )
        _ = self.ports

    @property
    def title(self):
        """That which was given."""
        from spiral.physics.formulas.definition import parse_sections

        return str(parse_sections(self.text).get("title") or self.plugin_name())

    @property
    def wrapped(self):
        """The compiled function."""
        from spiral.physics.outside.function import wrap_function

        return wrap_function(self.function, self.text)


def _example(t, x, u, p):
    """A mass on a spring."""
    return [x.v, (u.F - p.c * x.v - p.k * x.x) / p.m]
