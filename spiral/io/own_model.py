"""A model that a user has already: a right-hand side in Python, or a file of equations."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from spiral.io.python_model import system_of_file
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.system_files import is_python_file, plugin_of_file
from spiral.types.errors import ConfigError
from spiral.types.system import System

FIELDS = {
    "fmu": {"ports": "forces", "inputs": "recorded", "observed": "measured", "free": "free"},
    "robot": {"ports": "places", "inputs": "recorded", "observed": "measured", "free": "free"},
}
"""Plugin that reads a file -> (argument of ``system`` -> field of the plugin)."""
Quantity = str | float | Sequence[Any] | Mapping[str, Any]


def structure(
    source: str | Path | Mapping[str, Any],
    nodes: str | Path | Mapping[str, Any] | Sequence[Mapping[str, Any]],
    *,
    size: int = 20,
    band: Sequence[float],
    pairs: Mapping[str, Sequence[str]] | None = None,
    damping_ratio: float = 0.01,
    highest: float | None = None,
) -> System:
    """A system from mass, damping and stiffness matrices, reduced (Craig and Bampton 1968).

        beam = spiral.structure("beam.npz", "nodes.csv", size=8, band=(0, 300))
        print(beam.report)

    Parameters
    ----------
    source : NPZ or MAT file with ``M`` and ``K``, where there are also ``C``, ``G`` (per rad/s of
        the input ``speed``) and parts ``K_NAME`` of the stiffness beside K; or name -> array,
        sparse matrix, Matrix Market or Harwell-Boeing file.
    nodes : degrees of freedom that are kept: CSV with the columns ``name, dof, use, unit``, or name
        -> ``{"dof": 12, "use": "sensor input port"}``, or a list of such rows with their ``name``;
        ``dof`` counts from zero.
    size : coordinates that are left: the nodes, and modes with the nodes held.
    band : Hz, where the response is compared with that of the full structure (``report``).
    pairs : port -> two nodes between which effects act.
    damping_ratio : of every mode, where there is no ``C``.
    highest : Hz; modes above it are lowered to it by mass, so that they do not set the step of the
        integration. Left out, four times the end of the band.

    Raises
    ------
    InputError, ConfigError : a file, a matrix or a node that cannot be used.
    """
    from spiral.io.readers.matrices import read_structure

    text = read_structure(source, nodes, size, band, pairs, damping_ratio, highest)
    return load_registry(NO_FOLDER).make("system", "structure", {"text": text})


def system(
    source: Callable[..., Any] | str | Path | Mapping[str, Any] | Sequence[str],
    states: Mapping[str, Any] | None = None,
    inputs: Mapping[str, Any] | Sequence[str] | None = None,
    parameters: Mapping[str, Quantity] | None = None,
    observed: Sequence[str] = (),
    *,
    free: Sequence[str] = (),
    let: Mapping[str, str] | None = None,
    constants: Mapping[str, Quantity] | None = None,
    ports: Mapping[str, str | Sequence[str]] | None = None,
    mass: Mapping[str, Any] | Sequence[Sequence[Any]] | None = None,
    title: str = "",
) -> System:
    """A system from a right-hand side x' = rhs(t, x, u, p), or from a file of equations.

        spiral.system(rhs, states={"x": "m", "v": "m/s"}, inputs={"F": "N"},
                      parameters={"m": (2.0, "kg")}, observed=["x"])
        spiral.system(["m*x'' + c*x' + k*x = F"], states={"x": "m"}, inputs={"F": "N"},
                      parameters={"m": "2 kg", "c": "3 N*s/m", "k": "400 N/m"}, observed=["x"])
        spiral.system("two_masses.yaml")
        spiral.system("machine.py")
        spiral.system("car.fmu", ports={"body": "F_body"}, free=["k"])
        spiral.system("arm.xml", inputs=["shoulder"], free=["elbow_damping"])

    The function is called once, with expressions in place of numbers, and becomes equations
    (``system.text``, which a file may hold): the function itself is not needed any more, neither
    in other processes nor where a saved run is read. One that cannot be followed so (an ``if``, a
    table) is compiled by Numba, its slopes found by differences, and a warning says so. An FMU is a
    program, which this call runs.

    Parameters
    ----------
    source : ``rhs(t, x, u, p)``, later arguments left out where they are not used; it returns the
        rates in the order of ``states``, or by name. ``x``, ``u``, ``p`` give values by name
        (``x.v``, ``x["v"]``) and by number. Or equations, as a list or, with all else, as a mapping
        of what a file holds. Or a file: YAML, TOML, JSON and Python (which is run, and whose
        ``system`` is taken) alone, an FMU with
        ``ports`` (coordinate -> the input that a force on it goes through), ``inputs`` (names of
        those that are recorded), ``observed`` and ``free``; a robot (MJCF, URDF) likewise, its
        ``inputs`` the actuators and joints whose commands and torques are recorded.
    states : name -> unit; a state whose rate is another state is a position, the other its rate.
    inputs : name -> unit, or ``{"unit": "N", "interpolation": "zero_order"}``.
    parameters : name -> ``(value, unit)`` or ``"2.0 kg"``: known. A unit alone, a name in ``free``,
        or ``{"value": 2.0, "unit": "kg", "lower": 0.0, "upper": 5.0}`` for bounds.
    observed : states that are measured; the others are hidden.
    free : parameters with a value that the fit moves all the same.
    let : name -> formula, of equations: it stands for that formula wherever it is written.
    constants : name -> ``"9.81 m/s^2"``, of equations: numbers with a unit.
    ports : name -> position where effects act, as a formula of the states (``"z - x"``), or one for
        each axis. Every other coordinate has a port of its own name.
    mass : coordinate -> inertia (``{"x": "m"}``), or rows of the mass matrix, where a force on one
        coordinate moves others too; left out, what the accelerations are divided by.

    Raises
    ------
    ConfigError : a line that cannot be followed, units that do not fit, a name that is not known.
    InputError : a file that cannot be read.
    """
    observed = [observed] if isinstance(observed, str) else list(observed)
    if strange := [o for o in observed if not isinstance(o, str | Mapping)]:
        expected = "text: a state, x', x'' or NAME = FORMULA"
        raise ConfigError(f"observed: {strange[0]!r}", expected, 'observed=["a = v\'"]')
    given = {
        "title": title or None, "states": states or {}, "inputs": inputs, "parameters": parameters,
        "observed": observed, "free": list(free) or None, "ports": ports, "mass": mass,
        "let": let, "constants": constants,
    }  # fmt: skip
    given = {k: v for k, v in given.items() if v is not None}
    if callable(source):
        return _system_from_function(source, given)
    if isinstance(source, Mapping | list | tuple):
        return _system_from_equations(source, given)
    return _system_from_file(str(source), given)


def _system_from_equations(
    source: Mapping[str, Any] | Sequence[str], given: Mapping[str, Any]
) -> System:
    """A system from equations given in Python, under the same keys as in a file."""
    from spiral.physics.formulas.definition import check_free_parameters, definition_of
    from spiral.physics.formulas.function import dump_sections

    whole = dict(source) if isinstance(source, Mapping) else {"equations": list(source)}
    more = {k: v for k, v in given.items() if v}
    if twice := sorted(set(whole) & set(more)):
        raise ConfigError(f"{', '.join(twice)}, in the mapping and beside it", "one of them")
    text = dump_sections({**whole, **more})
    system = load_registry(NO_FOLDER).make("system", "equations", {"text": text})
    check_free_parameters(definition_of(text))
    return system


def _system_from_file(file: str, given: Mapping[str, Any]) -> System:
    """A system from a file; an FMU or a robot also takes ports, inputs and free parameters."""
    left = {k: v for k, v in given.items() if v}
    if is_python_file(file):
        if left:
            raise ConfigError(f"the file {file!r} and {', '.join(left)}", "the file alone")
        return system_of_file(file)
    plugin = plugin_of_file(file) or "equations"
    registry = load_registry(NO_FOLDER)
    if file in registry.names("system"):
        raise ConfigError(
            f"spiral.system({file!r}), the name of a system that there is",
            "equations, a function or a file",
            f"the name where a system is asked for: spiral.discover(record, {file!r})",
        )
    known = FIELDS.get(plugin, {})
    fields = {known[k]: left.pop(k) for k in list(left) if k in known}
    if left:
        raise ConfigError(
            f"the file {file!r} and {', '.join(left)}",
            f"the file, {', '.join(known)}" if known else "the file alone",
        )
    registry = replace(registry, programs=frozenset([file]))
    return registry.make("system", plugin, {"path": file, **fields})


def _system_from_function(rhs: Callable[..., Any], given: Mapping[str, Any]) -> System:
    """A right-hand side as equations; one that cannot be traced as compiled code.

    Raises
    ------
    ConfigError : a function that can be neither, with both reasons.
    """
    from spiral.physics.formulas.function import CannotTraceError, definition_from, dump_sections

    if constants := given.get("constants"):
        raise ConfigError(
            f"constants {', '.join(constants)}, beside a function",
            "numbers in the function itself (9.81), whose units follow from those of all else",
            "a parameter with a value, which is known and stays: (9.81, 'm/s^2')",
        )
    registry = load_registry(NO_FOLDER)
    try:
        return registry.make(
            "system", "equations", {"text": dump_sections(definition_from(rhs, given))}
        )
    except CannotTraceError as traced:
        try:
            compiled_system = registry.make(
                "system", "function", {"function": rhs, "text": dump_sections(given)}
            )
        except ConfigError as compiled:
            hint = f"{traced.try_}; {compiled.given}".removeprefix("; ")
            raise ConfigError(traced.given, traced.expected, hint) from compiled
        warnings.warn(
            f"{traced.given}: called as compiled code, its slopes by differences. "
            f"To have it traced: {traced.try_ or traced.expected}",
            stacklevel=3,
        )
        return compiled_system
