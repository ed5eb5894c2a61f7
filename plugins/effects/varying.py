"""Parameters that are no constants: the value that acts is a factor times the parameter's own.

v is what the parameter follows, a state, an input or time: a conductance grows with the flow, a
resistance with temperature, a stiffness sinks with time, a damper is set by its current. The factor
is one at the reference r (of a power where v is its unit), which a free parameter is the value at.
The reference is zero, where the records come near it. Of what is far from zero all along (a
temperature in K, a pressure) it is the middle of what they cover, and where the parameter is known
it is fitted: it tells at which v the value that was given holds. A point is counted from there.
"""

from __future__ import annotations

from dataclasses import replace

from spiral_plugins.effects.restoring import COUNT, wave

from spiral.math import exp, length, log, positive, tanh
from spiral.types.effect import ParameterEffect
from spiral.types.parameter import Parameter

_REFERENCE = Parameter("reference", "position", start=0.0, role="shape", grid=(1.0,), centre=True)
_FROM = replace(_REFERENCE, choice=True)
"""Where a point is counted from: no fit moves both."""


class LinearChange(ParameterEffect):
    """A parameter that changes in proportion to what it follows: value = p (1 + a (v - r)).

    The first term of any smooth dependence: resistance of copper with temperature, a spring that
    ages with time, a damper set by a current.
    """

    parameters = (Parameter("slope", "1/position"), _REFERENCE)

    def factor(self, at, u, p):
        """1 + a (v - r)."""
        (v,) = at.position
        return 1 + p.slope * (v - p.reference)


class MagnitudeChange(ParameterEffect):
    """A parameter that grows with the size of what it follows: value = p (1 + a |v|).

    A damper whose drag is linear and quadratic (p v + p a |v| v, Morison et al. 1950), a resistance
    to a flow that turns turbulent, a loss with an alternating load. The corner at zero is rounded
    over a hundredth of the largest v. It is tried where v goes to both sides of zero: elsewhere it
    is a change in proportion.
    """

    parameters = (
        Parameter("slope", "1/position"),
        Parameter("unit", "position", lower=0.0, role="shape", grid=(1.0,), two_sided=True),
    )

    def factor(self, at, u, p):
        """1 + a |v|."""
        (v,) = at.position
        corner = 0.01 * p.unit
        return 1 + p.slope * (length([v, corner]) - corner)


class PeriodicChange(ParameterEffect):
    """A parameter that repeats N times in a turn: value = p (1 + a cos(N v) + b sin(N v)).

    v in rad: what a pump with few rollers delivers, a motor's constant, a gear's ratio with a
    wheel off its axis, a friction that follows the angle. N is tried from 1 to 24 and,
    where the record shows it, beyond.
    """

    units = ("rad",)
    periodic = True
    parameters = (
        Parameter("cosine", ""),
        Parameter("sine", ""),
        COUNT,
    )

    def factor(self, at, u, p):
        """1 + a cos(N v) + b sin(N v)."""
        return 1 + wave(at.position[0], p)


class QuadraticChange(ParameterEffect):
    """A parameter that changes by a parabola of what it follows: value = p (1 + a w + b w^2).

    w = v - r.
    """

    special = ("linear_change",)
    parameters = (
        Parameter("slope", "1/position"),
        Parameter("curvature", "1/position^2"),
        _REFERENCE,
    )

    def factor(self, at, u, p):
        """1 + a w + b w^2."""
        (v,) = at.position
        w = v - p.reference
        return 1 + p.slope * w + p.curvature * w * w


class PowerChange(ParameterEffect):
    """A parameter that grows with a power of what it follows: value = p |v/l|^n, n = 0 if constant.

    p is the value at v = l, the largest v of the records: heat transfer with flow^0.8 (Dittus and
    Boelter 1930), drag with density. The corner at zero is rounded over a hundredth of l.
    """

    parameters = (
        Parameter("exponent", ""),
        Parameter("unit", "position", lower=0.0, role="shape", grid=(1.0,)),
    )

    def factor(self, at, u, p):
        """|v/l|^n."""
        (v,) = at.position
        return exp(p.exponent * log(length([v / p.unit, 0.01])))


class ExponentialChange(ParameterEffect):
    """A parameter that grows exponentially with what it follows: value = p exp(b (v - r)).

    Viscosity, decay, a reaction's rate with temperature over a narrow range.
    """

    parameters = (Parameter("rate", "1/position"), _REFERENCE)

    def factor(self, at, u, p):
        """exp(b (v - r))."""
        (v,) = at.position
        return exp(p.rate * (v - p.reference))


class ArrheniusChange(ParameterEffect):
    """A parameter that is activated by temperature: value = p exp(A (1/r - 1/v)), v in K.

    A reaction's rate (Arrhenius 1889), a diffusion, with A < 0 a viscosity or the resistance of an
    electrolyte or a thermistor. A is the activation energy over the gas constant. It is tried where
    v stays far from zero.
    """

    parameters = (
        Parameter("activation", "K"),
        Parameter("reference", "position", lower=0.0, role="shape", grid=(1.0,), centre=True),
    )

    def factor(self, at, u, p):
        """exp(A (1/r - 1/v)), 1/v rounded within 1e-4 r of zero."""
        (v,) = at.position
        return exp(p.activation * (1 / p.reference - v / (v**2 + (1e-4 * p.reference) ** 2)))


class InverseChange(ParameterEffect):
    """A parameter whose inverse is linear in what it follows: value = p / (1 + a (v - r)).

    A rope's stiffness with its free length, a force over a gap, compliances in series, a reaction
    that is inhibited (1 + S/K_i). The divisor is rounded above zero (``spiral.math.positive``).
    """

    parameters = (Parameter("slope", "1/position"), _REFERENCE)

    def factor(self, at, u, p):
        """1 / (1 + a (v - r))."""
        (v,) = at.position
        return 1 / positive(1 + p.slope * (v - p.reference))


class InverseQuadraticChange(ParameterEffect):
    """A parameter that falls alike on both sides of zero: value = p / (1 + b v^2), b >= 0.

    The inductance of a coil whose iron saturates with its current, a gain near a resonance, a
    friction that falls with sliding speed, a rate that its own substance inhibits.
    """

    parameters = (Parameter("curvature", "1/position^2", lower=0.0),)

    def factor(self, at, u, p):
        """1 / (1 + b v^2)."""
        (v,) = at.position
        return 1 / (1 + p.curvature * v * v)


class SaturatingChange(ParameterEffect):
    """A parameter that changes up to a limit: value = p (1 + a tanh((v - r)/l))."""

    special = ("linear_change",)
    parameters = (
        Parameter("change", ""),
        Parameter("scale", "position", lower=0.0, role="shape", grid=(0.1, 0.3), spread=True),
        _REFERENCE,
    )

    def factor(self, at, u, p):
        """1 + a tanh((v - r)/l)."""
        (v,) = at.position
        return 1 + p.change * tanh((v - p.reference) / p.scale)


class SwitchedChange(ParameterEffect):
    """A parameter of another value beyond a point: value = p (1 + a s), s from 0 to 1 at v = r + l.

    s = (1 + tanh((v - r - l)/w)) / 2: a valve that opens, a regime that turns turbulent, a contact
    that closes, a part that breaks at a time.
    """

    parameters = (
        Parameter("change", ""),
        Parameter("point", "position", role="shape", grid=(-0.5, 0.0, 0.3, 0.5, 0.7), spread=True),
        Parameter(
            "width", "position", lower=0.0, role="shape", grid=(0.03,), most=0.25, spread=True
        ),
        _FROM,
    )

    def factor(self, at, u, p):
        """1 + a (1 + tanh((v - r - l)/w)) / 2."""
        (v,) = at.position
        return 1 + 0.5 * p.change * (1 + tanh((v - p.reference - p.point) / p.width))


class PeakChange(ParameterEffect):
    """A parameter that peaks, or dips, at a point: value = p (1 + a exp(-((v - r - l)/w)^2)).

    A heat capacity where something melts, an enzyme's optimum of temperature or pH, an absorption
    near a line, a loss where something resonates, an efficiency at its best point.
    """

    parameters = (
        Parameter("change", "", lower=-1.0),
        Parameter("point", "position", role="shape", grid=(-0.6, -0.2, 0.2, 0.6), spread=True),
        Parameter(
            "width", "position", lower=0.0, role="shape", grid=(0.15, 0.4), most=1.0, spread=True
        ),
        _FROM,
    )

    def factor(self, at, u, p):
        """1 + a exp(-((v - r - l)/w)^2)."""
        (v,) = at.position
        return 1 + p.change * exp(-(((v - p.reference - p.point) / p.width) ** 2))


class OtherValue(ParameterEffect):
    """A known parameter that is not as it was given: value = p (1 + e).

    A mass from a drawing, a catalog's resistance, a volume without what is built in. It is asked of
    known parameters alone; one that is free has the value that the record tells.
    """

    steady = True
    parameters = (Parameter("error", ""),)

    def factor(self, at, u, p):
        """1 + e."""
        return 1 + p.error
