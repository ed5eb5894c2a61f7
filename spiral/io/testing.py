"""The conformance suite of plugins: what ``spiral check NAME`` runs, and what a test calls.

    assert not failed(check_effect(MyEffect(), PlanarRotor()))

No check raises: each is a ``Check`` with what was seen and what to try.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from spiral.engine.filter.observer import Observer
from spiral.engine.gate import Gate
from spiral.inference.strategies.base import Strategy
from spiral.io.conformance import (
    declared,
    derivatives,
    observers,
    physics,
    regression,
    simulation,
    units,
)
from spiral.io.registry import error_summary
from spiral.types.derivative import Derivative
from spiral.types.effect import (
    Effect,
    FlowEffect,
    ForceEffect,
    InputEffect,
    ParameterEffect,
    SensorEffect,
    is_path,
)
from spiral.types.errors import ConfigError, InputError, PluginError, SpiralError
from spiral.types.fields import construct, field_names, plain
from spiral.types.learner import Learner
from spiral.types.library import Library
from spiral.types.plugin import Plugin
from spiral.types.record import Record
from spiral.types.source import Source
from spiral.types.system import System, has_coordinates

if TYPE_CHECKING:
    from spiral.io.registry import Entry, Registry


@dataclass(frozen=True)
class Check:
    """One check: its name, whether it passed, what was seen, what to try, and on what."""

    name: str
    passed: bool
    seen: str
    try_: str = ""
    on: str = ""

    def __str__(self) -> str:
        told = "passes" if self.passed else "FAILS"
        tried = f"; try: {self.try_}" if self.try_ and not self.passed else ""
        return f"{self.name}: {told}, {self.seen}{tried}"

    def as_dict(self) -> dict[str, Any]:
        """As ``spiral check --json`` writes it."""
        return {
            "check": self.name,
            "passed": self.passed,
            "seen": self.seen,
            "try": self.try_,
            "on": self.on,
        }


Step = tuple[str, Callable[[], str], str]
"""(name of a check, the check: what was seen or an error, what to try)."""


def failed(checks: Iterable[Check]) -> list[Check]:
    """Those that did not pass."""
    return [c for c in checks if not c.passed]


def check_effect(effect: Effect, system: System) -> list[Check]:
    """An effect at its port of a system: text, units, Jacobians, rest, linearity, own states.

    After a check that the others rest on (it fits, it traces) has failed, no more are run.
    """
    still = isinstance(effect, SensorEffect) and not has_coordinates(system)
    seeing = getattr(effect, "rated", False) or is_path(effect)  # rates that the seed is part of
    driven = seeing or isinstance(effect, InputEffect | ParameterEffect)
    beside = system.seed if still or driven else ()  # flows that a reading or an input may show
    whole, bare = physics.Physics(system, (*beside, effect)), physics.Physics(system, beside)
    return _run_checks(
        f"{effect.label} on {system.plugin_name()}",
        [
            ("docstring", lambda: physics.docstring_equation(effect), _SAY),
            (
                "fits",
                lambda: physics.check_port(effect, system),
                "another system, or another port: NAME@PORT",
            ),
            ("parameters", lambda: physics.check_effect_declarations(effect, system), _UNITS),
            ("traces", lambda: physics.check_tracing(whole), _TRACE),
            (
                "own states",
                lambda: physics.check_own_states(effect, whole),
                "return their rates from rate()",
            ),
            ("units", lambda: units.check_equation_units(system, (effect,)), _UNITS),
            ("jacobians", lambda: physics.check_jacobians(whole), _SMOOTH),
            ("finite at rest", lambda: physics.check_finite_values(whole), _REST),
            ("linear in amplitudes", lambda: physics.check_linearity(effect, whole), _LINEAR),
            ("absent at zero", lambda: physics.check_absent_at_zero(effect, whole, bare), _LINEAR),
        ],
    )


def check_system(system: System) -> list[Check]:
    """A system with its seed: names, units, tracing, mass, Jacobians, rest, a short record."""
    whole = physics.Physics(system)
    return _run_checks(
        system.plugin_name(),
        [
            ("docstring", lambda: physics.docstring_equation(system), _SAY),
            ("names", lambda: physics.check_names(system), ""),
            ("parameters", lambda: units.check_declared_units(system), _UNITS),
            ("declares", lambda: declared.describe_declarations(system), ""),
            ("traces", lambda: physics.check_tracing(whole), _TRACE),
            (
                "units of the seed",
                lambda: units.check_equation_units(system, system.seed),
                _UNITS,
            ),
            ("mass", lambda: physics.check_mass_matrix(system), _MASS),
            ("units of the equations", lambda: units.check_system_equations(system), _UNITS),
            ("injections", lambda: physics.check_injections(system), ""),
            ("jacobians", lambda: physics.check_jacobians(whole), _SMOOTH),
            ("finite at rest", lambda: physics.check_finite_values(whole), _REST),
            ("simulates", lambda: simulation.check_simulation(system), _STABLE),
        ],
    )


def check_records(name: str, source: Source, system: System) -> Check:
    """Whether the records of a study can be read, with what was understood; ``name`` its part."""
    return _run_step(
        name, system.plugin_name(), lambda: declared.describe_records(source, system), ""
    )


def check_source(source: Source, system: System) -> list[Check]:
    """A source asked for the records of a system; a refusal that says what to change passes."""
    return _run_checks(
        f"{source.plugin_name()} for {system.plugin_name()}",
        [
            ("docstring", lambda: physics.docstring_summary(source), _SAY),
            (
                "fields",
                lambda: _check_fields(source),
                "fields of plain values, each with a default",
            ),
            (
                "loads",
                lambda: _check_loading(source, system),
                "raise InputError for what cannot be used",
            ),
            (
                "repeatable",
                lambda: _check_repeatable_loads(source, system),
                "seed what is random by a field",
            ),
            ("as test", lambda: _check_as_test(source), "return a Source from as_test()"),
        ],
    )


def check_derivative(derivative: Derivative) -> list[Check]:
    """An estimator of derivatives on a sine; a refusal that says what to change passes."""
    return _run_checks(
        derivative.plugin_name(),
        [
            ("docstring", lambda: physics.docstring_equation(derivative), _SAY),
            (
                "fields",
                lambda: _check_fields(derivative),
                "fields of plain values, each with a default",
            ),
            (
                "follows a sine",
                lambda: derivatives.check_sine(derivative),
                "slopes per second",
            ),
            (
                "repeatable",
                lambda: derivatives.check_repeatable_estimate(derivative),
                "no hidden state, and no writing into the samples",
            ),
        ],
    )


def check_observer(observer: Observer, systems: Sequence[System]) -> list[Check]:
    """An observer over short records of systems with nominal values; it may refuse some."""
    watched = observers.ObserverRuns(observer, systems)
    return _run_checks(
        observer.plugin_name(),
        [
            ("docstring", lambda: physics.docstring_equation(observer), _SAY),
            (
                "fields",
                lambda: _check_fields(observer),
                "fields of plain values, each with a default",
            ),
            (
                "reconstructs",
                lambda: observers.check_reconstruction(watched),
                "(samples, states) arrays",
            ),
            (
                "covariances",
                lambda: observers.check_covariances(watched),
                "0.5 * (P + P.T); Joseph",
            ),
            ("innovations", lambda: observers.check_innovations(watched), "S = C P C^T + R"),
            (
                "follows",
                lambda: observers.check_tracking_error(watched),
                "signs and order of the states",
            ),
            (
                "repeatable",
                lambda: observers.check_repeatable_reconstruction(watched),
                "copies, no memory",
            ),
        ],
    )


def check_evidence(plugin: Plugin, registry: Registry) -> list[Check]:
    """A learner, a library or a gate: what it is for, and that it repeats itself."""
    steps: list[Step] = [
        ("docstring", lambda: physics.docstring_equation(plugin), _SAY),
        ("fields", lambda: _check_fields(plugin), "fields of plain values, each with a default"),
    ]
    if isinstance(plugin, Learner):
        steps.append(
            ("learns", lambda: regression.check_learning(plugin), "scaled inputs and outputs")
        )
        steps.append(
            (
                "repeatable",
                lambda: regression.check_repeatable_learning(plugin),
                "use the seed given",
            )
        )
    elif isinstance(plugin, Library):
        systems = [registry.make("system", name) for name in registry.names("system")]
        steps.append(("terms", lambda: regression.check_library_terms(plugin, systems), _UNITS))
    elif isinstance(plugin, Gate):
        steps.append(
            ("judges", lambda: regression.check_judgement(plugin), "indices of trial.kept")
        )
        steps.append(
            ("log", lambda: regression.check_gate_log(plugin), "float(...) of NumPy numbers")
        )
    return _run_checks(plugin.plugin_name(), steps)


def check_strategy(strategy: Strategy, registry: Registry) -> list[Check]:
    """A strategy in its first round on a small study of which a spring is missing."""
    from spiral.io.conformance import strategies

    at = strategies.FirstRound(strategy, registry)
    return _run_checks(
        strategy.plugin_name(),
        [
            ("docstring", lambda: physics.docstring_equation(strategy), _SAY),
            (
                "fields",
                lambda: _check_fields(strategy),
                "fields of plain values, each with a default",
            ),
            (
                "takes a round",
                lambda: strategies.check_first_round(at),
                "begin, propose and settle",
            ),
            ("admits candidates", lambda: strategies.check_admissions(at), "problem.candidates"),
            ("log", lambda: strategies.check_run_log(at), "float(...) of NumPy numbers"),
        ],
    )


def check_plugin(entry: Entry, registry: Registry) -> list[Check]:
    """A registered plugin: an effect on every system that it fits, a source for every system."""
    if entry.kind == "derivative":
        return check_derivative(registry.make("derivative", entry.name))
    if entry.kind in ("learner", "gate", "library"):
        return check_evidence(registry.make(entry.kind, entry.name), registry)
    if entry.kind == "strategy":
        return check_strategy(registry.make("strategy", entry.name), registry)
    if entry.kind == "system":
        return check_system(registry.make("system", entry.name))
    systems = [registry.make("system", name) for name in registry.names("system")]
    if entry.kind == "effect":
        systems.append(registry.make("system", "equations", {"text": _FIRST_ORDER}))
        return _check_on_systems(registry.make("effect", entry.name), systems)
    if entry.kind == "observer":
        return check_observer(registry.make("observer", entry.name), systems)
    if entry.kind == "source":
        source = registry.make("source", entry.name)
        return [c for system in systems for c in check_source(source, system)]
    return _run_checks(
        entry.name, [("docstring", lambda: physics.docstring_summary(entry.plugin), _SAY)]
    )


def misfit(effect: Effect, system: System) -> str:
    """Why an effect does not fit a system (axes, inputs, units); empty where it does."""
    from spiral.types.placement import check_effect as check_needs
    from spiral.types.units import check_units

    if isinstance(effect, ForceEffect) and not has_coordinates(system):
        return "a force needs a system with coordinates"
    try:
        check_needs(system, effect)
        check_units(system, effect)
    except SpiralError as error:
        # Without a cause from pint (the sine of a length) its own units are wrong, so that it
        # would pass only where positions are angles: its checks name that.
        wrong = isinstance(error, PluginError) and error.__cause__ is None
        return "" if wrong else f"{error.given}, expected {error.expected}"
    except (AttributeError, KeyError) as error:
        return f"it lacks {error}" if isinstance(effect, FlowEffect) else ""
    except Exception:  # a defect of the effect, which its checks name
        return ""
    return ""


_FIRST_ORDER = """
title: A warm body and its case in a room, two concentrations, a speed, two pressures
equations: ["body' = k*heating - c*(body - room)", "case' = -c*(case - room)", "a' = -c*a",
  "b' = -c*b", "v' = -c*v", "p' = -c*p", "q' = c*(p - q)"]
states: {body: K, case: K, a: mol/l, b: mol/l, v: m/s, p: Pa, q: Pa}
inputs: {heating: W, room: K}
parameters: {k: 0.1 K/J, c: 0.1 1/s}
observed: [body, a]
"""
"""States of first order beside those of the shipped systems."""
_SAY = "a first line that says what it is, and a line with its equation: F = -k q"
_UNITS = "units relative to the port (force, position, velocity) or absolute ones such as kg*m^2"
_TRACE = "plain arithmetic and functions of spiral.math; where(...) in place of if"
_SMOOTH = "functions with derivatives: tanh(v / w) or where(...) in place of jumps"
_MASS = "one row and column for each coordinate, symmetric"
_REST = (
    "avoid x / |x| and roots at zero (spiral.math.length stays smooth there); what may not be "
    "zero, as a temperature in a quotient: where(x > least, x, least), least a parameter"
)
_STABLE = "nominal values of a stable motion"
_LINEAR = "amplitudes as plain factors; role='shape' for gaps, widths and exponents"
# After one of these has failed, the checks behind it are meaningless and are not run.
_ESSENTIAL = ("fits", "names", "parameters", "traces", "fields", "loads", "reconstructs",
              "takes a round")  # fmt: skip


# What fails where one of these has failed says nothing of its own and is left out.
_RESTS_ON = {"jacobians": ("mass",), "finite at rest": ("mass",),
             "simulates": ("mass", "finite at rest")}  # fmt: skip


def _run_checks(on: str, steps: Sequence[Step]) -> list[Check]:
    checks: list[Check] = []
    for name, step, advice in steps:
        if any(c.name in _RESTS_ON.get(name, ()) for c in failed(checks)):
            continue
        checks.append(_run_step(name, on, step, advice))
        if not checks[-1].passed and name in _ESSENTIAL:
            break
    return checks


def _run_step(name: str, on: str, step: Callable[[], str], advice: str) -> Check:
    try:
        return Check(name, True, step(), "", on)
    except SpiralError as error:
        seen = f"{error.given}; expected {error.expected}"
        return Check(name, False, seen, error.try_ or advice, on)
    except Exception as error:
        return Check(name, False, error_summary(error), advice, on)


def _check_on_systems(effect: Effect, systems: Sequence[System]) -> list[Check]:
    reasons = [(s, misfit(effect, s)) for s in systems]
    checks = [c for s, reason in reasons if not reason for c in check_effect(effect, s)]
    if checks:
        return checks
    seen = "; ".join(f"{s.plugin_name()}: {reason}" for s, reason in reasons) or "no system"
    advice = "correct its units, or put a system that it fits into the plugin folder"
    return [Check("fits a system", False, f"it fits none. {seen}", advice, effect.label)]


def _check_fields(plugin: Plugin) -> str:
    """Fields become plain values and come back as they were."""
    own = {k: getattr(plugin, k) for k in field_names(type(plugin))}
    given = {k: plain(v) for k, v in own.items()}

    inside = [p for v in own.values() for p in (v if isinstance(v, tuple) else (v,))]

    def resolve_nested(kind: type, value: Any, where: str) -> Any:  # a plugin inside a field
        return next(v for v in inside if isinstance(v, kind) and plain(v) == value)

    if construct(type(plugin), given, plugin.plugin_name(), resolve_nested) != plugin:
        raise PluginError("fields that do not come back from plain values", "the same fields")
    return ", ".join(given) or "none"


def _check_loading(source: Source, system: System) -> str:
    """Records of the system, or a refusal that says what to change."""
    records = _load_or_refusal(source, system)
    if isinstance(records, SpiralError):
        return f"refused: {records.given}, expected {records.expected}"
    if not isinstance(records, tuple) or not records:
        raise PluginError(f"load() gives {type(records).__name__}", "a tuple of records")
    for record in records:
        if not isinstance(record, Record) or tuple(record.channels) != tuple(system.observed):
            raise PluginError(f"load() gives {record!r:.60}", "records made by make_record(system)")
    return f"{len(records)} record of {records[0].samples} samples"


def _load_or_refusal(source: Source, system: System) -> Any:
    try:
        return source.load(system)
    except (InputError, ConfigError) as error:
        return error


def _check_repeatable_loads(source: Source, system: System) -> str:
    """Loading twice gives the same numbers."""
    once, again = (_load_or_refusal(source, system) for _ in range(2))
    if isinstance(once, SpiralError):
        return "refused"
    if [r.sha256 for r in once] != [r.sha256 for r in again]:
        raise PluginError("two loads that differ", "the same records each time")
    return once[0].sha256[:12]


def _check_as_test(source: Source) -> str:
    """What a test record takes from this source is a source."""
    other = source.as_test()
    if not isinstance(other, Source):
        raise PluginError(f"as_test() gives {type(other).__name__}", "a Source")
    return "the same" if other == source else "another"
