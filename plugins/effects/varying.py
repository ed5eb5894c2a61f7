"""Parameters that are no constants: the value that acts is a factor times the parameter's own.

v is what the parameter follows, a state, an input or time: a conductance grows with the flow, a
resistance with temperature, a stiffness sinks with time, a damper is set by its current. The factor
is one where v is zero (of a power where v is its unit): a free parameter is the value there.
"""

from __future__ import annotations

from spiral.math import exp, length, log, positive, tanh
from spiral.types.effect import ParameterEffect
from spiral.types.parameter import Parameter


class LinearChange(ParameterEffect):
    """A parameter that changes in proportion to what it follows: value = p (1 + a v).

    The first term of any smooth dependence: resistance of copper with temperature, a spring that
    ages with time, a damper set by a current.
    """

    parameters = (Parameter("slope", "1/position"),)

    def factor(self, at, u, p):
        """1 + a v."""
        (v,) = at.position
        return 1 + p.slope * v


class QuadraticChange(ParameterEffect):
    """A parameter that changes by a parabola of what it follows: value = p (1 + a v + b v^2)."""

    special = ("linear_change",)
    parameters = (Parameter("slope", "1/position"), Parameter("curvature", "1/position^2"))

    def factor(self, at, u, p):
        """1 + a v + b v^2."""
        (v,) = at.position
        return 1 + p.slope * v + p.curvature * v * v


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
    """A parameter that grows exponentially with what it follows: value = p exp(b v).

    A reaction's rate with temperature (Arrhenius 1889, over a narrow range), viscosity, decay.
    """

    parameters = (Parameter("rate", "1/position"),)

    def factor(self, at, u, p):
        """exp(b v)."""
        (v,) = at.position
        return exp(p.rate * v)


class InverseChange(ParameterEffect):
    """A parameter whose inverse changes in proportion to what it follows: value = p / (1 + a v).

    A rope's stiffness with its free length, a force over a gap, compliances in series, a reaction
    that is inhibited (1 + S/K_i). The divisor is rounded above zero (``spiral.math.positive``).
    """

    parameters = (Parameter("slope", "1/position"),)

    def factor(self, at, u, p):
        """1 / (1 + a v)."""
        (v,) = at.position
        return 1 / positive(1 + p.slope * v)


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
    """A parameter that changes up to a limit: value = p (1 + a tanh(v/l))."""

    special = ("linear_change",)
    parameters = (
        Parameter("change", ""),
        Parameter("scale", "position", lower=0.0, role="shape", grid=(0.1, 0.3)),
    )

    def factor(self, at, u, p):
        """1 + a tanh(v/l)."""
        (v,) = at.position
        return 1 + p.change * tanh(v / p.scale)


class SwitchedChange(ParameterEffect):
    """A parameter of another value beyond a point: value = p (1 + a s), s from 0 to 1 around v = l.

    s = (1 + tanh((v - l)/w)) / 2: a valve that opens, a regime that turns turbulent, a contact that
    closes, a part that breaks at a time.
    """

    parameters = (
        Parameter("change", ""),
        Parameter("point", "position", role="shape", grid=(-0.5, 0.0, 0.3, 0.5, 0.7)),
        Parameter("width", "position", lower=0.0, role="shape", grid=(0.03,), most=0.25),
    )

    def factor(self, at, u, p):
        """1 + a (1 + tanh((v - l)/w)) / 2."""
        (v,) = at.position
        return 1 + 0.5 * p.change * (1 + tanh((v - p.point) / p.width))


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
