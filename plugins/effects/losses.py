"""Flows into any state of first order: what leaks, spills, radiates, is exchanged or consumed.

x is a level, a temperature, a charge, a concentration, a share: any state that a system lets
something flow into, wherever it stands (``linear_loss@box_wall``). Losses count from the state's
zero, so that where the surroundings are not at zero a ``constant_flow`` belongs to them; where an
input has the surroundings, most losses count from it as well (``quadratic_loss@room-outside``).
"""

from __future__ import annotations

from spiral_plugins.effects.restoring import WIDTH

from spiral.math import exp, length, ramp, sqrt, tanh, where
from spiral.types.effect import StateFlow
from spiral.types.parameter import Parameter

_ZERO = Parameter("zero", "K", role="shape", grid=(0.0, 293.15), choice=True)  # of a temperature


class ConstantFlow(StateFlow):
    """Something that always flows, in or out: x' = ... + f.

    A leak from a large store, a standing load, a bias of the flow meter.
    """

    parameters = (Parameter("flow", "force"),)

    def flow(self, at, u, p):
        """f."""
        return [p.flow]


class LinearLoss(StateFlow):
    """A loss in proportion to what is there: x' = ... - c x.

    Laminar leakage, conduction to the surroundings, decay, a resistor across a capacitor.
    """

    differences = True
    parameters = (Parameter("rate", "force/position", lower=0.0),)

    def flow(self, at, u, p):
        """-c x."""
        return [-p.rate * at.position[0]]


class RootLoss(StateFlow):
    """Flow through an orifice under its own head: x' = ... - c sign(x) sqrt(|x|) (Torricelli).

    A hole in a tank, turbulent leakage between pressures. The root is rounded off near zero,
    x / (x^2 + w^2)^(1/4).
    """

    differences = True
    parameters = (
        Parameter("rate", "force/position^0.5", lower=0.0),
        Parameter("width", "position", lower=0.0, role="shape", grid=(0.02,)),
    )

    def flow(self, at, u, p):
        """-c x / (x^2 + w^2)^(1/4)."""
        (x,) = at.position
        return [-p.rate * x / sqrt(sqrt(x * x + p.width * p.width))]


class QuadraticLoss(StateFlow):
    """A loss that grows with the square: x' = ... - c |x| x.

    Turbulent drag on what flows, a reaction of two equal partners, crowding.
    """

    differences = True
    parameters = (Parameter("rate", "force/position^2", lower=0.0),)

    def flow(self, at, u, p):
        """-c |x| x."""
        (x,) = at.position
        return [-p.rate * length([x]) * x]


class CubicLoss(StateFlow):
    """A loss, or a gain, that grows with the cube: x' = ... - c x^3.

    The first term of any odd law beyond the linear one: a resistor that warms, a core that
    saturates, charge transfer that eases at high overvoltage.
    """

    differences = True
    parameters = (Parameter("rate", "force/position^3"),)

    def flow(self, at, u, p):
        """-c x^3."""
        (x,) = at.position
        return [-p.rate * x * x * x]


class AsymmetricLoss(StateFlow):
    """A loss that is larger one way than the other: x' = ... - c |x|, beside a linear loss.

    c more where x is positive, c less where it is negative: a check valve that leaks, a diode, the
    rebound of a damper on a speed that is a state of first order. Of what is never negative it is a
    ``linear_loss``.
    """

    units = ("m/s", "rad/s", "Pa", "bar", "V", "A", "1")
    special = ("linear_loss",)
    differences = True
    parameters = (Parameter("rate", "force/position"),)

    def flow(self, at, u, p):
        """-c |x|."""
        return [-p.rate * length([at.position[0]])]


class SaturatingLoss(StateFlow):
    """A loss that cannot exceed its capacity: x' = ... - v x / (K + |x|).

    An enzyme or a microbe that is saturated (Michaelis and Menten 1913; Monod 1949), a cleaner at
    its limit. v is the capacity, K where half of it is reached. Far below K it is a
    ``linear_loss``.
    """

    special = ("linear_loss", "dry_loss")
    parameters = (
        Parameter("capacity", "force", lower=0.0),
        Parameter("half", "position", lower=0.0, role="shape", grid=(0.1, 0.4)),
    )

    def flow(self, at, u, p):
        """-v x / (K + |x|)."""
        (x,) = at.position
        return [-p.capacity * x / (p.half + length([x]))]


class ThresholdLoss(StateFlow):
    """A loss that begins at a threshold: x' = ... - c (x - r)_+, or c (r - x)_+ for r below zero.

    A relief valve, a spillway, a vessel that runs over, a Zener diode, a limiter that cuts in. The
    corner of (.)_+ is rounded over +-w (``spiral.math.ramp``). With the threshold at zero it is a
    ``linear_loss`` of what is never negative.
    """

    special = ("linear_loss",)
    differences = True
    parameters = (
        Parameter("rate", "force/position", lower=0.0),
        Parameter("threshold", "position", role="shape", grid=(0.5, 0.7, 0.9, -0.5, -0.7, -0.9)),
        WIDTH,
    )

    def flow(self, at, u, p):
        """-c (x - r)_+ or c (r - x)_+."""
        (x,) = at.position
        above, below = ramp(x - p.threshold, p.width), ramp(p.threshold - x, p.width)
        return [p.rate * where(p.threshold > 0, -above, below)]


class ExponentialLoss(StateFlow):
    """A loss that grows exponentially, one way: x' = ... - c sign(w) (exp(x / w) - 1).

    Charge transfer under its overvoltage (Tafel 1905), a diode (Shockley 1949), a leak of what
    softens with heat. c is the exchange or saturation current over the capacity, w the e-fold (at
    25 deg C 26 mV times the ideality); a negative w is a diode the other way round.
    """

    differences = True
    parameters = (
        Parameter("level", "force", lower=0.0),
        Parameter("width", "position", role="shape", grid=(0.12, 0.3, -0.12, -0.3)),
    )

    def flow(self, at, u, p):
        """-c sign(w) (exp(x / w) - 1)."""
        grown = exp(at.position[0] / p.width) - 1
        return [p.level * where(p.width > 0, -grown, grown)]


class DryLoss(StateFlow):
    """A loss that has its sign alone from a speed, a current or a flow: x' = ... - f tanh(x / w).

    Dry friction of a speed that is a state of first order (``coulomb_friction`` per unit of mass);
    the voltage drop of brushes, of diodes, of an inverter's dead time; the yield stress of what
    flows (Bingham).
    """

    units = ("m/s", "rad/s", "A", "m^3/s", "kg/s")
    differences = True
    parameters = (
        Parameter("level", "force", lower=0.0),
        Parameter("width", "position", lower=0.0, role="shape", grid=(0.003, 0.02, 0.1)),
    )

    def flow(self, at, u, p):
        """-f tanh(x / w)."""
        return [-p.level * tanh(at.position[0] / p.width)]


class SlewLimit(StateFlow):
    """A state that moves no faster than R: x' = f - s f (1 - 1 / (1 + (f / R)^8)^(1/8)).

    f is the rate that the model gives it by itself. A servo valve, the pitch of a blade, a rudder,
    an amplifier at its slew rate, a burner that may not ramp faster; whole at s = 1: within 1 % f
    up to 0.73 R, R from 1.4 R on. Of an input that the model passes on without a state it is
    ``rate_limit``.
    """

    rated = True
    whole = {"share": 1.0}
    parameters = (
        Parameter("share", "", lower=0.0),
        Parameter("rate", "velocity", lower=0.0, role="shape", grid=(0.15, 0.4, 0.7)),
    )

    def flow(self, at, u, p):
        """-s f (1 - (1 + (f / R)^8)^(-1/8))."""
        (own,) = at.velocity
        over = (own / p.rate) ** 8
        return [-p.share * own * (1 - 1 / sqrt(sqrt(sqrt(1 + over))))]


class RadiationLoss(StateFlow):
    """Heat radiated to surroundings at 293.15 K: x' = ... - r ((z + x)^4 - T^4), T = 293.15 K.

    Stefan and Boltzmann; r = emissivity times 5.67e-8 W/m^2/K^4 times area over heat capacity. z is
    the temperature of the state's zero: 0 K for an absolute one, 293.15 K for one above the room's.
    Not far from the room it is hardly told from a ``quadratic_loss``.
    """

    parameters = (
        Parameter("rate", "force/K^4", lower=0.0),
        _ZERO,
        Parameter("room", "K", role="shape", grid=(293.15,)),
    )

    def flow(self, at, u, p):
        """-r ((z + x)^4 - T^4)."""
        (x,) = at.position
        return [-p.rate * ((p.zero + x) ** 4 - p.room**4)]


class RadiationExchange(StateFlow):
    """Heat radiated to what has a temperature of its own: x' = ... - r ((z + x)^4 - (z + y)^4).

    y is an input or another state: a collector under a measured sky, an ingot in its furnace. r and
    z as of a ``radiation_loss``, to which it comes where y hardly changes.
    """

    differences = "only"
    parameters = (
        Parameter("rate", "force/K^4", lower=0.0),
        _ZERO,
    )

    def flow(self, at, u, p):
        """-r ((z + x)^4 - (z + y)^4)."""
        there = p.zero + at.outside
        return [-p.rate * ((there + at.position[0]) ** 4 - there**4)]


class MutualRadiation(StateFlow):
    """Heat radiated between two bodies: x_i' = ... - c_i ((z + x_i)^4 - (z + x_j)^4), i, j = 1, 2.

    A muffle and the ware in it, a filament and its bulb. c_1 and c_2 are one emissivity times
    5.67e-8 W/m^2/K^4 times area over either capacity, z as of a ``radiation_loss``. Of temperatures
    that hardly move it is an ``exchange``.
    """

    axes = 2
    special = ("exchange",)
    parameters = (
        Parameter("rate", "force/K^4", lower=0.0, per_axis=True),
        _ZERO,
    )

    def flow(self, at, u, p):
        """-c_1 d and c_2 d, d = (z + x_1)^4 - (z + x_2)^4."""
        first, second = ((p.zero + x) ** 4 for x in at.position)
        return [-p.rate[0] * (first - second), p.rate[1] * (first - second)]


class Exchange(StateFlow):
    """Two states that even out: x_1' = ... - c_1 (x_1 - x_2), x_2' = ... - c_2 (x_2 - x_1).

    Conduction between two bodies, diffusion, a leak between two chambers; c_1 and c_2 are one
    conductance over either capacity.
    """

    axes = 2
    parameters = (Parameter("rate", "force/position", lower=0.0, per_axis=True),)

    def flow(self, at, u, p):
        """-c_1 (x_1 - x_2) and -c_2 (x_2 - x_1)."""
        first, second = at.position
        return [-p.rate[0] * (first - second), -p.rate[1] * (second - first)]


class OrificeExchange(StateFlow):
    """Turbulent flow between two chambers: x_1' = ... - c_1 s, x_2' = ... + c_2 s.

    s = sign(d) sqrt(|d|) of the difference d = x_1 - x_2 (Torricelli): an orifice, a worn seal, a
    valve that does not close; c_1 and c_2 are one conductance over either capacity. The root is
    rounded off near zero, d / (d^2 + w^2)^(1/4); far below w it is an ``exchange``. Temperatures do
    not flow so.
    """

    axes = 2
    special = ("exchange",)
    units = ("m", "Pa", "bar")
    parameters = (
        Parameter("rate", "force/position^0.5", lower=0.0, per_axis=True),
        Parameter("width", "position", lower=0.0, role="shape", grid=(0.01,)),
    )

    def flow(self, at, u, p):
        """-c_1 s and c_2 s."""
        d = at.position[0] - at.position[1]
        s = d / sqrt(sqrt(d * d + p.width * p.width))
        return [-p.rate[0] * s, p.rate[1] * s]


class Conversion(StateFlow):
    """What turns from one into the other: x_1' = ... - c_1 x_1 + c_2 x_2, x_2' the opposite.

    Immunity that wanes, a reaction of first order and its reverse, people who move: what one loses
    the other gains. Between shares, amounts and concentrations; no temperature turns into another.
    """

    axes = 2
    units = ("1", "kg", "mol", "g/l", "mol/l", "1/l")
    parameters = (Parameter("rate", "force/position", lower=0.0, per_axis=True),)

    def flow(self, at, u, p):
        """-f and f, f = c_1 x_1 - c_2 x_2."""
        turned = p.rate[0] * at.position[0] - p.rate[1] * at.position[1]
        return [-turned, turned]


class MutualFlow(StateFlow):
    """A flow in proportion to both of two states: x_i' = ... + c_i x_1 x_2 for i = 1, 2.

    Infection, predation, a reaction of two partners (mass action; Lotka 1925, Volterra 1926),
    inhibition, between concentrations. No law multiplies two temperatures or two levels; of shares
    of a population it is not offered, because it imitates whatever an epidemic's fit has missed.
    """

    axes = 2
    units = ("g/l", "mol/l", "1/l")
    parameters = (Parameter("rate", "force/position^2", per_axis=True),)

    def flow(self, at, u, p):
        """c_1 x_1 x_2 and c_2 x_1 x_2."""
        both = at.position[0] * at.position[1]
        return [p.rate[0] * both, p.rate[1] * both]


class StateCoupling(StateFlow):
    """A state that also acts where the model gives it no path: x' = ... + c v, or a force c v.

    v is of another unit: the back-EMF of a motor, the force of a coil, heat of a reaction that
    warms its vessel, pressure that lifts a valve. It acts one way; of two ways each is one effect.
    """

    driver = "state"
    parameters = (Parameter("gain", "force/position"),)

    def flow(self, at, u, p):
        """c v."""
        (other,) = at.position
        return [p.gain * other]


class QuadraticStateCoupling(StateFlow):
    """The square of a state that acts where the model gives it no path: x' = ... + c v^2.

    v is of another unit: heat of a current or of friction, radiation pressure of a field, the pull
    of a magnet, lift and thrust. Where v hardly changes it looks like ``state_coupling``.
    """

    driver = "state"
    parameters = (Parameter("gain", "force/position^2"),)

    def flow(self, at, u, p):
        """c v^2."""
        (other,) = at.position
        return [p.gain * other**2]
