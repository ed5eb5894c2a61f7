"""Conformance checks of effects and systems: each returns what it saw, or raises an error.

f_x, f_p, h_x, h_p are those of the compiled model, held against central differences
(f(z + d) - f(z - d)) / 2d.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from spiral.io.conformance.units import parse_units
from spiral.physics.starts import fill_declared_starts
from spiral.types.effect import Effect, InputEffect, ParameterEffect, SensorEffect, is_path
from spiral.types.errors import PluginError, did_you_mean
from spiral.types.fields import field_names
from spiral.types.label import parameter_of
from spiral.types.parameter import Parameter
from spiral.types.placement import model_keys
from spiral.types.plugin import Plugin
from spiral.types.record import Array
from spiral.types.system import MechanicalSystem, System, has_coordinates

if TYPE_CHECKING:
    from spiral.physics.compile import CompiledModel
    from spiral.physics.trace import TracedModel

_STEP, _TOLERANCE, _EXACT = 1e-5, 1e-5, 1e-12
_FRACTION = 0.1  # of a drawn amplitude, where a parameter varies
_SMALL = 1e-4  # amplitudes at which a reading is linear, if it is so to leading order
_DRAWS = 16
_AT_REST = "at rest (inputs 0, states too unless they are declared to begin elsewhere)"
_SPREAD = 0.02  # of a value that was given, within which others are tried
_SIZES = (1.0, 0.1, 0.01, 1e-3)  # of states and inputs, tried in turn until values are finite
_GUARD = "guard roots, logarithms and quotients: functions of spiral.math, where(x > 0, ..., 0)"
_GUARD_IN_FILE = (
    "maximum(x, small) in a quotient, root or logarithm, with small among the constants; or say "
    "where a state begins: {unit: ..., start: ...}"
)


@dataclass(frozen=True)
class Physics:
    """The compiled model of a system with effects (left out: its seed), made when first asked for.

    f and h are stacked into one vector.
    """

    system: System
    effects: tuple[Effect, ...] | None = None

    @cached_property
    def compiled(self) -> CompiledModel:
        """Its functions."""
        from spiral.physics.compile import compile_model
        from spiral.physics.trace import trace

        return compile_model(
            trace(self.system, self.system.seed if self.effects is None else self.effects)
        )

    def evaluate(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array]:
        """(f, h) and its Jacobians in x and p."""
        parts = []
        traced = self.compiled.traced
        for function, count in (
            (self.compiled.rate, len(traced.states)),
            (self.compiled.output, len(traced.channels)),
        ):
            value = np.zeros(count)
            by_x, by_p = np.zeros((count, len(x))), np.zeros((count, len(p)))
            function(x, u, p, value, by_x, by_p)
            parts.append((value, by_x, by_p))
        value, by_x, by_p = (np.concatenate(part) for part in zip(*parts, strict=True))
        return value, by_x, by_p

    def draw_point(self, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Random states, inputs and parameters, the last near given values or within their bounds.

        Parameters that vary change by a fraction: a mass that passes zero has no acceleration.
        States are about where they are declared to begin, and nearer if an exponential overflows.
        """
        traced, given = self.compiled.traced, _given_values(self.system)
        x, u = (rng.normal(size=len(names)) for names in (traced.states, traced.inputs))
        rest = rest_states(traced)
        x *= np.where(rest == 0, 1.0, _FRACTION * rest)
        pairs = zip(traced.keys, traced.parameters, strict=True)
        p = np.array([_value_near(q, given.get(k), rng.uniform(0.3, 0.9)) for k, q in pairs])
        for effect in self.effects or ():
            if isinstance(effect, ParameterEffect):
                p[self.amplitudes(effect)] *= _FRACTION
        for size in _SIZES:
            if all(np.isfinite(v).all() for v in self.evaluate(rest + size * x, size * u, p)):
                return rest + size * x, size * u, p
        return rest + x, u, p

    def amplitudes(self, effect: Effect) -> Array:
        """Which parameters are amplitudes of the effect."""
        return self._of_role(effect, "amplitude")

    def shapes(self, effect: Effect) -> Array:
        """Which parameters are shapes of the effect."""
        return self._of_role(effect, "shape")

    def _of_role(self, effect: Effect, role: str) -> Array:
        traced = self.compiled.traced
        pairs = zip(traced.keys, traced.parameters, strict=True)
        own = [k.startswith(f"{effect.label}.") and q.role == role for k, q in pairs]
        return np.array(own, dtype=bool)


def _given_values(system: System) -> dict[str, float]:
    """Values that the author of a system gave, by key."""
    first = {f"system.{q.name}": q.start for q in system.parameters if q.start is not None}
    return {**first, **system.defaults}


def _value_near(parameter: Parameter, given: float | None, share: float) -> float:
    """Within ``_SPREAD`` of a value that was given (share 0.6: itself); else as bounds allow."""
    low, high = (b if b is not None else s * np.inf for b, s in zip(
        (parameter.lower, parameter.upper), (-1, 1), strict=True))  # fmt: skip
    if given is None or not low < given < high:
        return _value_in_bounds(parameter, share)
    near = given * (1 + _SPREAD * (share - 0.6) / 0.3)
    return near if low < near < high else given


def _value_in_bounds(parameter: Parameter, share: float) -> float:
    """``share`` itself where the bounds allow it, else that share of the way between them."""
    low, high = parameter.lower, parameter.upper
    if (low is None or low <= share) and (high is None or share <= high):
        return share
    if low is None:
        return float(high or 0.0) - share
    return low + share * ((low + 1.0 if high is None else high) - low)


def docstring_summary(plugin: Plugin | type[Plugin]) -> str:
    """The first line of the docstring."""
    meaning = plugin.meaning()
    kind = plugin if isinstance(plugin, type) else type(plugin)
    if not meaning or meaning.startswith(f"{kind.__name__}("):  # what dataclass writes by itself
        raise PluginError("no docstring", "a first line that says what it is")
    return meaning


def docstring_equation(plugin: Plugin) -> str:
    """The line of the docstring that holds the equation."""
    docstring_summary(plugin)
    for line in (inspect.getdoc(type(plugin)) or "").splitlines():
        if " = " in line:
            return line.strip()
    raise PluginError("a docstring without an equation", "a line with ' = '")


def check_port(effect: Effect, system: System) -> str:
    """The port: its axes and the system's inputs are what the effect needs."""
    from spiral.types.placement import check_effect as check_needs

    return f"port {check_needs(system, effect).name}"


def check_effect_declarations(effect: Effect, system: System) -> str:
    """Parameters and own states: each name once, units that parse, an amplitude."""
    port = system.place(effect)
    _check_unique("parameter", [q.name for q in effect.parameters])
    _check_unique("state", [s.name for s in effect.states])
    if not effect.amplitudes():
        raise PluginError(
            "no parameter of role 'amplitude'",
            "one that is zero when the effect is absent",
            "Parameter('stiffness', 'force/position') and use it as a factor",
        )
    return parse_units({i.name: port.unit(i.unit) for i in (*effect.parameters, *effect.states)})


def _check_unique(kind: str, names: Sequence[str]) -> None:
    twice = sorted({n for n in names if list(names).count(n) > 1})
    if twice:
        raise PluginError(f"{kind} {', '.join(twice)} twice", "each name once")


def check_tracing(physics: Physics) -> str:
    """The physics becomes expressions and compiles."""
    traced = physics.compiled.traced
    return f"{len(traced.states)} states, {len(traced.keys)} parameters"


def check_own_states(effect: Effect, physics: Physics) -> str:
    """States that the effect brings have rates."""
    own = [n for n in physics.compiled.traced.states if n.startswith(f"{effect.label}.")]
    if effect.states and not own:
        raise PluginError("states of its own without rates", "a rate for each")
    return ", ".join(parameter_of(n) for n in own) or "none"


def check_jacobians(physics: Physics) -> str:
    """f_x, f_p, h_x, h_p against central differences at random states and parameters."""
    rng = np.random.default_rng(1)
    worst = max(_worst_jacobian_error(physics, *physics.draw_point(rng)) for _ in range(_DRAWS))
    return f"within {worst:.0e} of their size from central differences"


def _worst_jacobian_error(physics: Physics, x: Array, u: Array, p: Array) -> float:
    """Largest error as a share of what is there (of rates, of readings), all moved by a share."""
    names = (*physics.compiled.traced.states, *physics.compiled.traced.keys)
    value, *slopes = physics.evaluate(x, u, p)
    require_finite_rows(physics, value, np.hstack(slopes))
    size = np.concatenate([np.full(len(v), np.abs(v).max()) for v in np.split(value, [len(x)])])
    still = rest_states(physics.compiled.traced) == 0  # the others have sizes of their own
    own = np.where(still, np.abs(x[still]).max(initial=0.0), np.abs(x))
    point, scales = np.concatenate([x, p]), np.concatenate([own, np.abs(p)])
    scales[scales == 0] = 1.0
    worst = 0.0
    for name, given, d in zip(names, np.hstack(slopes).T, np.diag(scales), strict=True):
        ends = (point + _STEP * d, point - _STEP * d)
        above, below = (physics.evaluate(z[: len(x)], u, z[len(x) :])[0] for z in ends)
        slope = (above - below) / (2 * _STEP)  # by the share of the scale
        there = np.abs(slope) + size
        error = np.max(np.abs(given * d.max() - slope) / np.where(there > 0, there, 1.0))
        if not error <= _TOLERANCE:
            raise PluginError(
                f"derivative by {name!r} off by {error:.2g} of its size",
                f"at most {_TOLERANCE:.0e} from the central difference",
            )
        worst = max(worst, float(error))
    return worst


def require_finite_rows(physics: Physics, value: Array, slopes: Array) -> None:
    """An error that names the first rate or reading which is no number at some states."""
    rows = ~(np.isfinite(value) & np.isfinite(slopes).all(axis=1))
    if rows.any():
        raise PluginError(
            f"the {_row_names(physics)[int(np.argmax(rows))]} or a slope of it is not a number "
            "at some states",
            "finite numbers at all states, negative ones and zero included",
            _guard_advice(physics.system) or _GUARD,
        )


def _guard_advice(system: System) -> str:
    """What to try where a value is not finite, for formulas of a file; nothing for a class."""
    return _GUARD_IN_FILE if "text" in field_names(type(system)) else ""


def _row_names(physics: Physics) -> list[str]:
    """What stands in the rows of ``evaluate``: rates of states, then readings."""
    traced = physics.compiled.traced
    rates = [f"rate of {n!r}" for n in traced.states]
    return [*rates, *(f"reading {n!r}" for n in traced.channels)]


def rest_states(traced: TracedModel) -> Array:
    """(n,) states of a machine at rest: zero, but where one is declared to begin elsewhere."""
    states = np.zeros(len(traced.x))
    fill_declared_starts(traced, states, np.zeros(len(traced.u)))
    return states


def check_finite_values(physics: Physics) -> str:
    """Values and slopes at rest with inputs 0, and in motion, with amplitudes 0 and 1."""
    traced = physics.compiled.traced
    x, u, p = physics.draw_point(np.random.default_rng(2))
    pairs = zip(traced.keys, traced.parameters, strict=True)
    kept = np.array([k.startswith("system.") or q.role == "shape" for k, q in pairs], dtype=bool)
    for amplitude in (0.0, 1.0):
        given = np.where(kept, p, amplitude)
        for where, at in (
            (_AT_REST, (rest_states(traced), 0 * u, given)),
            ("in motion", (x, u, given)),
        ):
            parts = zip(("value", "slope by x", "slope by p"), physics.evaluate(*at), strict=True)
            for what, part in parts:
                if not np.isfinite(part).all():
                    row = int(np.argmax(~np.isfinite(part.reshape(len(part), -1)).all(axis=1)))
                    raise PluginError(
                        f"{what} {part[~np.isfinite(part)][0]} of the {_row_names(physics)[row]} "
                        f"{where} with amplitudes {amplitude:g}",
                        "finite numbers",
                        _guard_advice(physics.system),
                    )
    return "with amplitudes 0 and 1"


def check_linearity(effect: Effect, physics: Physics) -> str:
    """f(2a) - f(0) = 2 (f(a) - f(0)) in the amplitudes a, which change something.

    A reading, what acts of an input or along a path, a parameter's change are asked at small
    amplitudes: terms beyond leading order are small against the largest effect on a value. Shapes
    are smaller where the drawn motion does not reach them (a limit).
    """
    own = physics.amplitudes(effect)
    bent = isinstance(effect, SensorEffect | InputEffect | ParameterEffect) or is_path(effect)
    sizes, share = ((_SMALL, 0.1 * _SMALL), np.sqrt(_SMALL)) if bent else ((1.0,), _EXACT)
    missed = 0.0
    for size in sizes:
        none, one, two = _values_by_amplitude(physics, own, physics.shapes(effect), size)
        error, acted = np.abs((two - none) - 2 * (one - none)), np.abs(2 * (one - none))
        acted = acted.max(axis=0) if bent else acted
        if np.all(error <= _EXACT * (1 + np.abs(none)) + share * acted):
            return f"{int(own.sum())} amplitudes"
        missed = float(np.max(error))
    given = f"twice the amplitudes miss twice the effect by {missed:.2g}"
    raise PluginError(given, "an effect linear in its amplitudes")


def _values_by_amplitude(physics: Physics, own: Array, shapes: Array, size: float) -> Array:
    """(3, draws, values) without amplitudes, with them and with twice them, where these act."""
    for shrunk in _SIZES:
        rng, drawn = np.random.default_rng(3), []
        for _ in range(_DRAWS):
            x, u, p = physics.draw_point(rng)
            p = np.where(shapes, shrunk * p, p)
            scaled = (np.where(own, scale * p, p) for scale in (0.0, size, 2 * size))
            drawn.append([physics.evaluate(x, u, each)[0] for each in scaled])
        if np.any((values := np.moveaxis(np.array(drawn), 1, 0))[0] != values[1]):
            return values
    raise PluginError("the amplitudes change nothing", "an effect that acts")


def check_absent_at_zero(effect: Effect, physics: Physics, bare: Physics) -> str:
    """With zero amplitudes the system's own rates and readings are as without the effect."""
    x, u, p = physics.draw_point(np.random.default_rng(4))
    none = physics.evaluate(x, u, np.where(physics.amplitudes(effect), 0.0, p))[0]
    count = len(physics.system.states)
    alone = bare.evaluate(x[:count], u, p[: len(bare.compiled.traced.keys)])[0]
    kept = np.concatenate([none[:count], none[len(x) :]])
    error = np.abs(kept - alone)
    if not np.all(error <= _EXACT * (1 + np.abs(alone))):
        raise PluginError(
            f"with zero amplitudes it still changes the model by {np.nanmax(error):.2g}",
            "no change",
        )
    return "as without it"


def check_names(system: System) -> str:
    """States, channels, inputs, ports and parameters: each name once, and known where used."""
    states, inputs = [s.name for s in system.states], [i.name for i in system.inputs]
    readings = [r.name for r in system.readings]
    _check_unique("state, input or reading", [*states, *inputs, *readings])
    _check_unique("parameter", [q.name for q in system.parameters])
    _check_unique("channel", list(system.observed))
    _check_unique("port", [port.name for port in system.ports])
    _check_unique("effect of the seed", [e.label for e in system.seed])
    for what, listed, hint in (
        ("states", states, "states = (State('x', 'm'), ...)"),
        ("channels", system.observed, "observed = ('x',): the states that sensors report"),
        ("ports", system.ports, "ports = (Port('mass', ('x',), lambda q, p: [q.x], 'm', 'N'),): "
         "where effects may act"),
    ):  # fmt: skip
        if not listed:
            raise PluginError(f"no {what}", "at least one", hint)
    for port in system.ports:
        _check_unique(f"axis of port {port.name!r}", list(port.axes))
    _check_known("observed", system.observed, [*states, *readings])
    sources = [i.derived_from for i in system.inputs if i.derived_from]
    _check_known("derived_from", sources, inputs)
    keys = [k for k, _ in model_keys(system, system.seed)]
    _check_known("defaults", list(system.defaults), keys)
    hidden = [n for n in states if n not in system.observed]
    return f"observed {', '.join(system.observed)}; hidden {', '.join(hidden) or 'none'}"


def _check_known(what: str, given: Sequence[str], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            raise PluginError(
                f"{what} names {name!r}", f"one of {', '.join(known)}", did_you_mean(name, known)
            )


def check_injections(system: System) -> str:
    """What effects add to the system reaches its rates: every injection changes one."""
    from spiral.physics.signatures import injection_slopes

    columns, names = injection_slopes(system).T.tolist(), [i.name for i in system.injections]
    idle = [name for name, column in zip(names, columns, strict=True) if not any(column)]
    if idle:
        raise PluginError(
            f"no rate depends on injected[{idle[0]!r}]: effects there would do nothing",
            "every injection in the rates",
            f"add injected[{idle[0]!r}] to the rate that it changes",
        )
    return ", ".join(names) or "none"


def check_mass_matrix(system: System) -> str:
    """M(q, p) is n x n for n coordinates, symmetric and positive; ports have their axes."""
    if not has_coordinates(system):
        return "no coordinates: not a mechanical system"
    if not system.balanced:
        return "inside the program"
    coordinates = [c.name for c in system.coordinates]
    if [i.name for i in system.injections][: len(coordinates)] != coordinates:
        raise PluginError(
            f"injections {', '.join(i.name for i in system.injections)}",
            f"one for each coordinate, named like it: {', '.join(coordinates)}",
        )
    q, p = _mass_values(system)
    for port in system.ports:
        if len(port.coordinates(q, p)) != len(port.axes):
            raise PluginError(f"port {port.name!r}", "one coordinate for each of its axes")
    matrix = np.array(system.mass(q, p), dtype=float)
    if matrix.shape != (len(coordinates), len(coordinates)):
        raise PluginError(f"a mass matrix of shape {matrix.shape}", f"{len(coordinates)} squared")
    if not np.allclose(matrix, matrix.T, rtol=_EXACT, atol=0):
        raise PluginError("a mass matrix that is not symmetric", "M = M^T")
    least = float(np.linalg.eigvalsh(matrix).min())
    if not least > 0:
        raise PluginError(
            f"a mass matrix with eigenvalue {least:.3g} at {_values_in_mass(system, q, p)}",
            "a positive mass matrix",
            "values at which it is positive, or bounds that keep it so; check its signs",
        )
    return f"{len(coordinates)} x {len(coordinates)}, positive"


def _mass_values(system: MechanicalSystem) -> tuple[SimpleNamespace, SimpleNamespace]:
    """Random coordinates; parameters as they are given, others within their bounds."""
    rng, given = np.random.default_rng(5), _given_values(system)
    names = [s.name for s in (*system.coordinates, *system.others)]
    q = SimpleNamespace(**{n: rng.normal() for n in names})
    shares = [(k, 0.6 if f"system.{k.name}" in given else rng.uniform(0.3, 0.9))
              for k in system.parameters]  # fmt: skip
    near = {k.name: _value_near(k, given.get(f"system.{k.name}"), s) for k, s in shares}
    return q, SimpleNamespace(**near)


def _values_in_mass(system: MechanicalSystem, q: SimpleNamespace, p: SimpleNamespace) -> str:
    """The values that the mass matrix depends on, and whether they were given."""
    here = np.array(system.mass(q, p), dtype=float)
    words, given = [], _given_values(system)
    for place in (q, p):
        for name, value in vars(place).items():
            moved = SimpleNamespace(**{**vars(place), name: 1.37 * value + 0.01})
            pair = (moved, p) if place is q else (q, moved)
            if not np.array_equal(np.array(system.mass(*pair), dtype=float), here):
                own = place is p and f"system.{name}" in given
                words.append(f"{name} = {value:.4g}" + (" (given)" if own else " (tried)"))
    return ", ".join(words) or "all values"
