"""Effects with states of their own: what the machine stands on, and what follows it late.

Each is written so that its own states depend on the motion and on shapes alone; the amplitude
enters as a plain factor of what they exert. They begin in balance with a machine at rest, wherever
the zero of its position lies.
"""

from __future__ import annotations

from spiral.math import exp, length, log, ramp, where
from spiral.types.effect import ForceEffect, StateFlow
from spiral.types.parameter import Parameter, State

_TURN = 6.283185307179586


class HiddenMode(ForceEffect):
    """A resonance that no sensor sees: F = -m z'', z'' = w^2 e + 2 d w (q' - z'), e = q - z.

    A mass m on a spring m w^2 and a damper 2 d w m at the port, w = 2 pi f: the dynamic absorber
    (Den Hartog, Mechanical Vibrations, ch. 3; a residual mode in Ewins, Modal Testing, ch. 4). A
    mass M on a flexible foundation looks the same: its force k (z - q) differs by a spring, which
    belongs to the seed. One mass per axis, one frequency and one damping ratio for all.
    """

    special = ("linear_stiffness",)
    states = (
        State("deflection", "position", per_axis=True),
        State("velocity", "velocity", per_axis=True),
    )
    parameters = (
        Parameter("mass", "force*s^2/position", lower=0.0, per_axis=True),
        Parameter("natural_frequency", "Hz", lower=0.0, role="shape", spectrum=True),
        Parameter("damping_ratio", "", lower=0.0, role="shape", start=0.03, grid=(0.01, 0.03, 0.1)),
    )

    def force(self, at, u, p):
        """-m z'', the force that accelerates the hidden mass."""
        return [-m * a for m, a in zip(p.mass, _hidden_accelerations(at, p), strict=True)]

    def rate(self, at, u, p):
        """e' = q' - z', and z''."""
        apart = [v - w for v, w in zip(at.velocity, at.own.velocity, strict=True)]
        return {"deflection": apart, "velocity": _hidden_accelerations(at, p)}


def _hidden_accelerations(at, p):
    """z'' per axis, from spring and damper between port and hidden mass."""
    turn = _TURN * p.natural_frequency
    rows = zip(at.velocity, at.own.deflection, at.own.velocity, strict=True)
    return [turn * turn * e + 2 * p.damping_ratio * turn * (v - w) for v, e, w in rows]


class Lag(ForceEffect):
    """A force that follows the motion late: F = -k e, e' = q' - e / T.

    A spring k in series with a damper k T, beside the seed's spring: the standard linear solid
    (Maxwell element; Lakes, Viscoelastic Materials, ch. 2): rubber mounts, oil films, seals. Slow
    motion is not resisted, fast motion by the whole spring.
    """

    special = ("linear_stiffness", "linear_damping")
    states = (State("deflection", "position", per_axis=True),)
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0, per_axis=True),
        Parameter("time_constant", "s", lower=0.0, role="shape", start=0.01, spectrum=True),
    )

    def force(self, at, u, p):
        """-k e, e the spring's deflection."""
        return [-k * e for k, e in zip(p.stiffness, at.own.deflection, strict=True)]

    def rate(self, at, u, p):
        """q' - e / T."""
        apart = zip(at.velocity, at.own.deflection, strict=True)
        return {"deflection": [v - e / p.time_constant for v, e in apart]}


class HiddenStore(StateFlow):
    """A store that no sensor sees, filled and emptied: x' = ... - c (x - z), T z' = x - z.

    It begins as full as what it stands beside, as a body that has been there for long.

    Walls that take up gas, heat or moisture, a dead volume, a tissue, a second branch of resistor
    and capacitor: any body of one relaxation beside a state of first order. c T is its capacity
    over that of the state. What fills faster than the state moves adds to that capacity; what fills
    slower than the record lasts is a ``linear_loss``.
    """

    special = ("linear_loss",)
    states = (State("level", "position", like="position"),)
    parameters = (
        Parameter("rate", "force/position", lower=0.0),
        Parameter("time_constant", "s", lower=0.0, role="shape", start=0.01, spectrum=True),
    )

    def flow(self, at, u, p):
        """-c (x - z)."""
        return [-p.rate * (at.position[0] - at.own.level)]

    def rate(self, at, u, p):
        """(x - z) / T."""
        return {"level": (at.position[0] - at.own.level) / p.time_constant}


class BoucWen(ForceEffect):
    """Hysteresis: F = -k z, z' = v - (|v| z + r v |z|) |z / L|^(n - 1) / L.

    A spring k that begins to slip as its own deflection z nears L / (1 + r)^(1 / n). With r = 0 and
    n = 1 it is Dahl's friction (1968: presliding, then a force of k L whatever the speed); with
    others the loops of Bouc (1967) and Wen (1976): there A = 1, beta = 1 / L^n, gamma = r / L^n.
    The exponent n is one unless the record tells it: the larger, the sharper the bend. Near z = 0
    |z / L| is rounded over a hundredth.
    What it dissipates in a cycle does not depend on how fast it is run through, and its force
    depends on where the motion last turned round.
    """

    special = ("coulomb_friction", "linear_stiffness")
    states = (State("slip", "position", per_axis=True),)
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0, per_axis=True),
        Parameter("length", "position", lower=0.0, role="shape", grid=(0.05, 0.2, 0.6)),
        Parameter(
            "asymmetry", "", lower=-2.0, upper=2.0, role="shape", start=0.0, grid=(-1.0, 0.0, 1.0)
        ),
        Parameter("exponent", "", lower=1.0, upper=10.0, role="shape", start=1.0),
    )

    def force(self, at, u, p):
        """-k z."""
        return [-k * z for k, z in zip(p.stiffness, at.own.slip, strict=True)]

    def rate(self, at, u, p):
        """v - (|v| z + r v |z|) |z / L|^(n - 1) / L."""
        rates = []
        for v, z in zip(at.velocity, at.own.slip, strict=True):
            slips = (length([v]) * z + p.asymmetry * v * length([z])) / p.length
            rates.append(v - slips * exp((p.exponent - 1) * log(length([z / p.length, 0.01]))))
        return {"slip": rates}


class Jenkins(ForceEffect):
    """A spring that slides at its limit: F = -k z, z' = v, but 0 where |z| has reached L and grows.

    Jenkin's element: an elastic joint, a bolted lap, a tooth that sticks and slips at the force
    k L (Iwan, J. Appl. Mech. 33, 1966). Once the motion turns back it is stiff again at once. The
    last fifth before L is rounded; ``bouc_wen`` bends over from the first deflection on.
    """

    axes = 1
    special = ("coulomb_friction", "linear_stiffness")
    states = (State("slip", "position"),)
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0),
        Parameter("length", "position", lower=0.0, role="shape", grid=(0.05, 0.2, 0.6)),
    )

    def force(self, at, u, p):
        """-k z."""
        return [-p.stiffness * at.own.slip]

    def rate(self, at, u, p):
        """v (1 - s), s from 0 at |z| = 0.8 L to 1 at L where v z > 0."""
        (v,) = at.velocity
        return {"slip": _slip_rate(v, at.own.slip, p.length)}


def _slip_rate(v, z, limit):
    """z' of a spring that slides at its limit, the last fifth before it rounded."""
    depth, bend = length([z]) - 0.9 * limit, 0.05 * limit
    slides = (ramp(depth + bend, bend) - ramp(depth - bend, bend)) / (2 * bend)
    return v * where(v * z > 0 * v * z, 1 - slides, 1 + 0 * slides)


class Iwan(ForceEffect):
    """Five springs in parallel that slide one after the other: F = -k mean(z_i).

    Each z_i is a ``jenkins``, its limit L / 5, 3 L / 5, ... 9 L / 5: Iwan's uniform distribution
    about L (J. Appl. Mech. 33, 1966), a bolted joint whose contact slips from its edge inwards. But
    for the rounding of each corner inner loops close; those of ``bouc_wen`` drift. It is tried
    where it is asked for by name (``candidates=``).
    """

    axes = 1
    bare = True
    special = ("coulomb_friction", "linear_stiffness")
    states = tuple(State(f"slip{i}", "position") for i in range(5))
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0),
        Parameter("length", "position", lower=0.0, role="shape", grid=(0.05, 0.2, 0.6)),
    )

    def force(self, at, u, p):
        """-k times the mean of z_i."""
        return [-p.stiffness * sum(getattr(at.own, s.name) for s in self.states) / 5]

    def rate(self, at, u, p):
        """v, less where z_i is at its limit."""
        (v,) = at.velocity
        limits = [p.length * (2 * i + 1) / 5 for i in range(5)]
        pairs = zip(self.states, limits, strict=True)
        return {s.name: _slip_rate(v, getattr(at.own, s.name), x) for s, x in pairs}


class Lugre(ForceEffect):
    """Friction of bristles: F = -(k z + d z'), z' = v - |v| z / g(v), g = L (1 + r exp(-(v/s)^2)).

    A spring first, with a damper of its own; then it slides, at a force that falls with speed. At a
    constant v it is ``coulomb_friction`` of the level k L and ``stribeck_friction`` of k L r
    (Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Automatic Control 40, 1995; their
    viscous term is ``linear_damping``). With r and d zero it is ``bouc_wen`` without asymmetry. It
    is tried where it is asked for by name (``candidates=``).
    """

    special = ("bouc_wen", "coulomb_friction")
    bare = True
    states = (State("bristle", "position", per_axis=True),)
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0, per_axis=True),
        Parameter("damping", "force/velocity", lower=0.0, per_axis=True),
        Parameter("length", "position", lower=0.0, role="shape", grid=(0.05, 0.2, 0.6)),
        Parameter("rise", "", lower=0.0, role="shape", grid=(0.2, 0.6)),
        Parameter("speed", "velocity", lower=0.0, role="shape", grid=(0.05, 0.2)),
    )

    def force(self, at, u, p):
        """-(k z + d z') per axis."""
        rows = zip(p.stiffness, p.damping, at.own.bristle, _bristle_rates(at, p), strict=True)
        return [-(k * z + d * rate) for k, d, z, rate in rows]

    def rate(self, at, u, p):
        """v - |v| z / g(v)."""
        return {"bristle": _bristle_rates(at, p)}


def _bristle_rates(at, p):
    """z' per axis."""
    rates = []
    for v, z in zip(at.velocity, at.own.bristle, strict=True):
        ratio = v / p.speed
        rates.append(v - length([v]) * z / (p.length * (1 + p.rise * exp(-ratio * ratio))))
    return rates
