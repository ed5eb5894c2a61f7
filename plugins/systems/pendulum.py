"""A pendulum."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import GravityTorque

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class Pendulum(MechanicalSystem):
    """I theta'' + c theta' + g sin theta = torque: angle measured, rate hidden.

    A common factor of all terms leaves the motion as it is, so the inertia I is fixed to 1: torque
    and coefficients are per unit inertia. With ``torque_unit=N*m`` I is a number in kg m^2 that the
    fit finds, or that ``values`` and ``fixed`` set.
    """

    torque_unit: str = "rad/s^2"

    # The angle; the torque about the pivot; what is measured; what is applied.
    coordinates = (State("theta", "rad"),)
    observed = ("theta",)
    seed = (LinearDamping(), GravityTorque())
    injections = property(lambda self: (State("theta", self.torque_unit),))
    inputs = property(lambda self: (Input("torque", self.torque_unit, "band_limited"),))

    @property
    def parameters(self):
        """The inertia: 1 where torque is per unit inertia, else unknown."""
        start = 1.0 if self.torque_unit == "rad/s^2" else None
        return (Parameter("inertia", f"({self.torque_unit})*s^2/rad", lower=0.0, start=start),)

    @property
    def ports(self):
        """The pivot."""
        return (Port("pivot", ("theta",), lambda q, p: [q.theta], "rad", self.torque_unit),)

    def mass(self, q, p):
        """[[I]]."""
        return [[p.inertia]]

    def force(self, q, v, u, p):
        """The applied torque."""
        return [u.torque]
