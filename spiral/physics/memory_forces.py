"""Two families of test forces: functions of the present motion, and forces with memory.

With z = (q - q_0) / Q and w = (v - v_0) / V (means and deviations of position and velocity at a
port, the means zero where it has several axes), for every axis

    f(q, v, t) = sum a_i A_i(z) + sum b_j B_j(w) + sum c_ij C_i(z) D_j(w) + t (e q + g v)
                 + what is linear in other axes, and of third order in the radius

is a force without memory: natural cubic splines in z and in w, friction of several widths,
products of both, and a spring and damper that drift. A force that remembers has states that the
motion drives,

    T z' = T v - z                     a spring in series with a damper (Maxwell)
    z' = v - (|v| z + v |z|) / L       a spring that yields at L / 2 and is stiff again on return
    T z' = (q - q_0)^3 / Q^2 - z       a curved force that comes late

for times T and lengths L over the motion's own scales, and is linear in their amplitudes.
``LateReading`` and ``LateInput`` are what sensors and actuators do that average, lag or come late
by a few samples. None of these is a candidate: they tell whether what is missing has memory
(``spiral.inference.likelihood.memory``).
"""

from __future__ import annotations

from typing import Any

from spiral.math import length, maximum, tanh
from spiral.types.effect import ForceEffect, InputEffect, SensorEffect
from spiral.types.parameter import Parameter, State

_KNOTS = (-2.5, -1.0, -0.3, 0.3, 1.0, 2.5)  # of curves, in deviations of their state
_WIDTHS = (0.03, 0.15, 0.6)  # of friction, in V
LENGTHS = (0.3, 1.0, 3.0)  # of what yields, in Q
TIMES = (0.7, 2.0, 6.0)  # of what relaxes, in the motion's own time Q / V
_LATE = (1.0,)  # times of curved forces that come late
YIELDING = tuple(f"yielding{k}" for k in range(len(LENGTHS)))
RELAXING = (*(f"relaxing{k}" for k in range(len(TIMES))), *(f"late{k}" for k in range(len(_LATE))))
_PASSES = 3  # high-passes in series behind an input
_MOST = 3.0  # bound of each amplitude of LateInput: an input up to so many samples late

_SCALES = (
    Parameter("middle", "position", start=0.0, role="shape"),
    Parameter("reach", "position", lower=0.0, start=1.0, role="shape"),
    Parameter("drift", "velocity", start=0.0, role="shape"),
    Parameter("pace", "velocity", lower=0.0, start=1.0, role="shape"),
)


def _spline_terms(x: Any) -> list[Any]:
    """Natural cubic splines on the knots beside 1 and x: straight outside of them."""
    first, last = _KNOTS[:-1], _KNOTS[-1]
    cubes = {k: maximum(x - k, 0 * x) ** 3 for k in _KNOTS}
    parts = [(cubes[k] - cubes[last]) / (last - k) for k in first]
    return [part - parts[-1] for part in parts[:-1]]


def _product_terms(z: Any, w: Any, s: Any) -> list[Any]:
    """Damping and friction that depend on place, a spring that depends on velocity."""
    sizes = (z, length([z]))
    ways = (tanh(s / _WIDTHS[1]), length([w]))
    return [*(x * w for x in (*sizes, *_spline_terms(z))), *(x * y for x in sizes for y in ways)]


def _axis_terms(z: Any, w: Any, s: Any, t: Any) -> list[Any]:
    """All functions of one axis; s is v / V. The model's spring and damper have z and w."""
    friction = [tanh(s / x) for x in _WIDTHS]
    return [
        1 + 0 * z,
        *_spline_terms(z),
        *friction,
        *_spline_terms(w),
        *_product_terms(z, w, s),
        t * z,
        t * w,
    ]


_OWN = len(_axis_terms(0.0, 0.0, 0.0, 0.0))
_NAMES = (*(f"c{k}" for k in range(_OWN)), *(f"cross{k}" for k in range(4)))


class PresentForce(ForceEffect):
    """A force that is a function of the present position and velocity, with drifting coefficients.

    F_i = sum_k c_k b_k(q_i / Q, v_i / V, t / T), beside it q_j, v_j, r^2 q_i and r^2 v_i of a port
    with several axes.
    """

    bare = True
    inputs = ("time",)
    parameters = (
        *(Parameter(name, "force", per_axis=True) for name in _NAMES),
        *_SCALES,
        Parameter("record", "s", lower=0.0, start=1.0, role="shape"),
    )

    def force(self, at, u, p) -> list[Any]:
        """The sum per axis."""
        return [
            sum(getattr(p, name)[i] * x for name, x in zip(_NAMES, terms, strict=True))
            for i, terms in enumerate(self.terms(at, u, p))
        ]

    def terms(self, at, u, p) -> list[list[Any]]:
        """For every axis what its coefficients are factors of, by its shapes alone."""
        z = [(q - p.middle) / p.reach for q in at.position]
        w = [(v - p.drift) / p.pace for v in at.velocity]
        t, rows = u.time / p.record, []
        for i, (a, b) in enumerate(zip(z, w, strict=True)):
            others = [j for j in range(len(z)) if j != i]
            radius = sum(z[j] * z[j] for j in others)
            cross = [sum(z[j] for j in others), sum(w[j] for j in others), radius * a, radius * b]
            rows.append([*_axis_terms(a, b, at.velocity[i] / p.pace, t), *cross])
        return rows


class RememberedForce(ForceEffect):
    """A force with memory: springs that relax, springs that yield, curves that come late."""

    bare = True
    states = tuple(State(name, "position", per_axis=True) for name in (*YIELDING, *RELAXING))
    parameters = (
        *(Parameter(f"by_{name}", "force/position", per_axis=True) for name in YIELDING),
        *(Parameter(f"by_{name}", "force/position", per_axis=True) for name in RELAXING),
        *_SCALES,
    )

    def force(self, at, u, p) -> list[Any]:
        """The sum of all states, each times its amplitude."""
        names = (*YIELDING, *RELAXING)
        return [
            -sum(getattr(p, f"by_{name}")[i] * getattr(at.own, name)[i] for name in names)
            for i in range(len(at.position))
        ]

    def rate(self, at, u, p):
        """Rates of the states, by the laws at the head of this module."""
        time, shares = p.reach / p.pace, (*LENGTHS, *TIMES, *_LATE)
        rates: dict[str, Any] = {}
        for name, share in zip((*YIELDING, *RELAXING), shares, strict=True):
            rows = zip(at.position, at.velocity, getattr(at.own, name), strict=True)
            if name in YIELDING:
                rates[name] = [_yielding_rate(v, z, share * p.reach) for _, v, z in rows]
            elif name.startswith("relaxing"):
                rates[name] = [v - z / (share * time) for _, v, z in rows]
            else:
                cubes = ((q - p.middle) ** 3 / p.reach**2 - z for q, _, z in rows)
                rates[name] = [left / (share * time) for left in cubes]
        return rates


def _yielding_rate(v: Any, z: Any, limit: Any) -> Any:
    """v - (|v| z + v |z|) / L."""
    return v - (length([v]) * z + v * length([z])) / limit


class LateReading(SensorEffect):
    """A sensor that averages, lags or reports late: reading = y_i - a_i q_i' + b_i q_i''."""

    bare = True
    parameters = (
        Parameter("first", "s", per_axis=True),
        Parameter("second", "s^2", per_axis=True),
    )

    def reading(self, y, at, u, p):
        """y_i - a_i q_i' + b_i q_i''."""
        second = at.acceleration or (0,) * len(at.velocity)
        rows = zip(y, p.first, p.second, at.velocity, second, strict=True)
        return [value - a * v + b * acc for value, a, b, v, acc in rows]


class LateInput(InputEffect):
    """An input that comes a few samples late or averaged: acting = u + sum_k a_k h_k, k = 1, 2, 3.

    h_k is u behind k high-passes of one time, T s / (1 + T s): any short delay, mean or hold up to
    the third order in frequency. All inputs late look like all sensors late.
    """

    bare = True
    states = tuple(State(f"slow{k}", "position") for k in range(_PASSES))
    parameters = (
        *(Parameter(f"a{k}", "", lower=-_MOST, upper=_MOST) for k in range(_PASSES)),
        Parameter("time", "s", lower=0.0, start=0.01, role="shape"),
    )

    def drive(self, at, u, p):
        """u + sum_k a_k h_k."""
        fast = enumerate(_highpass_outputs(at))
        return at.position[0] + sum(getattr(p, f"a{k}") * h for k, h in fast)

    def rate(self, at, u, p):
        """Rates of the high-passes' states s_k, of which h_k is the output: T s_k' = h_k."""
        return {f"slow{k}": fast / p.time for k, fast in enumerate(_highpass_outputs(at))}


def _highpass_outputs(at: Any) -> list[Any]:
    """Outputs h_1, h_2, h_3 of the high-passes in series behind the input."""
    levels, given = [], at.position[0]
    for k in range(_PASSES):
        given = given - getattr(at.own, f"slow{k}")
        levels.append(given)
    return levels
