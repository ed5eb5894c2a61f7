"""What rotor systems share: inputs and the turned phase."""

from __future__ import annotations

from types import SimpleNamespace

from spiral.types.parameter import Input

ROTOR_INPUTS = (
    Input("speed", "rad/s", derivative=True),
    Input("phase", "rad", derived_from="speed"),
)


def turn_phase(u, p):
    """The inputs with the phase turned by the record's own origin."""
    return SimpleNamespace(**{**vars(u), "phase": u.phase + p.phase_origin})
