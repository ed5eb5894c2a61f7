"""An FMU as a system: what is recorded, what is measured, and where forces enter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from spiral.io.readers.fmu import Description, OpenFmu, Variable, open_fmu, read_description
from spiral.physics.formulas.function import dump_sections
from spiral.physics.outside.wrapped import (
    WrappedProgram,
    kinematic_rates,
    rate_equations,
    rate_inputs,
)
from spiral.types.cache import kept
from spiral.types.errors import ConfigError, did_you_mean


@kept(16)
def wrap_fmu(
    path: str,
    sha256: str,
    ports: tuple[tuple[str, str], ...],
    inputs: tuple[str, ...],
    observed: tuple[str, ...],
    free: tuple[str, ...],
) -> WrappedProgram:
    """An FMU with equations around it.

    Parameters
    ----------
    sha256 : of the file, which is run.
    ports : coordinate -> the FMU's input that a force on it goes through.
    inputs : those that a record has; left out, all that no port names.
    observed : states, or outputs that are a state; left out, all such outputs.
    free : parameters that the fit moves.

    Raises
    ------
    InputError : an FMU that cannot be used. ConfigError : a name that it has not.
    """
    about, opened = read_description(path, sha256), open_fmu(path, sha256)
    program = opened.program
    rates = kinematic_rates(program, len(about.states), opened.start)
    pushed = tuple(
        (_variable_name("a port", c, about.states), _variable_name("an input", entry, about.inputs))
        for c, entry in ports
    )
    for coordinate, entry in pushed:
        _check_input_pushes(opened, about, rates, coordinate, entry)
    through = {entry for _, entry in pushed}
    recorded = tuple(_variable_name("inputs", n, about.inputs) for n in inputs) or tuple(
        v.name for v in about.inputs if v.name not in through
    )
    text = dump_sections(_equation_sections(about, opened, rates, recorded, observed, free))
    sizes = (len(about.states), len(about.inputs), len(about.parameters))
    units = {v.name: v.unit for v in about.inputs}
    return WrappedProgram(
        program, sizes, text, recorded, tuple((c, e, units[e]) for c, e in pushed)
    )


def _equation_sections(
    about: Description,
    opened: OpenFmu,
    rates: Mapping[str, str],
    recorded: Sequence[str],
    observed: Sequence[str],
    free: Sequence[str],
) -> dict[str, Any]:
    """The equations around the FMU."""
    units = {v.name: v.unit for v in about.states}
    given = {v.name: v.unit for v in about.inputs if v.name in recorded}
    return {
        "title": about.title,
        "equations": rate_equations(opened.program, rates),
        "states": units,
        "inputs": {**given, **rate_inputs(opened.program, rates, units)},
        "parameters": {v.name: _parameter_section(v) for v in about.parameters},
        "free": [_variable_name("free", name, about.parameters) for name in free] or None,
        "observed": _measured_states(about, opened, observed),
    }


def _parameter_section(variable: Variable) -> dict[str, Any]:
    bounds = {"lower": variable.lower, "upper": variable.upper}
    given = {"value": variable.start, "unit": variable.unit, **bounds}
    return {k: v for k, v in given.items() if v is not None}


def _measured_states(about: Description, opened: OpenFmu, observed: Sequence[str]) -> list[str]:
    """What sensors report: states, named as such or by outputs that are them, and formulas."""
    states, readings = [v.name for v in about.states], dict(opened.readings)
    told = {v.told: v.name for v in about.states} | {n: n for n in states} | readings
    names = {v.name: readings[v.told] for v in about.outputs if v.told in readings}
    if not observed and not readings:
        raise ConfigError(
            f"FMU {about.path!r}, of whose outputs none is a state",
            "states that are measured, by name",
            f"system.observed=[{states[0]}]; states: {', '.join(states)}",
        )
    measured = []
    for name in observed or readings:
        if "'" in name or "=" in name:  # a formula of states
            measured.append(name)
            continue
        known = {**names, **told}
        if name not in known:
            outputs = {v.told for v in about.outputs}
            raise ConfigError(
                f"observed: {name}" + (", an output that is no state" if name in outputs else ""),
                f"a state, or an output that is one: {', '.join((*states, *readings))}",
                did_you_mean(name, known),
            )
        measured.append(known[name])
    return list(dict.fromkeys(measured))


def _variable_name(what: str, name: str, variables: Iterable[Variable]) -> str:
    """A variable by its own name or the FMU's."""
    known = {v.told: v.name for v in variables} | {v.name: v.name for v in variables}
    if name not in known:
        raise ConfigError(
            f"{what} {name!r} of the FMU",
            f"one of {', '.join(dict.fromkeys(known.values())) or 'none'}",
            did_you_mean(name, known.values()),
        )
    return known[name]


def _check_input_pushes(
    opened: OpenFmu, about: Description, rates: Mapping[str, str], coordinate: str, entry: str
) -> None:
    """Refuse an input that does not push the coordinate along.

    Raises
    ------
    ConfigError : a state without a rate, or an acceleration that the input does not raise.
    """
    program = opened.program
    if coordinate not in rates:
        raise ConfigError(
            f"a port at {coordinate}, whose rate is no state of the FMU",
            f"a coordinate: {', '.join(rates) or 'there is none'}",
        )
    row = program.rows.index(rates[coordinate])
    column = program.arguments.index(entry)
    _, slopes = program.values_and_slopes(np.array([opened.start]), (column,))
    if not slopes[0, 0, row] > 0:
        moved = [n for n, v in zip(program.rows, slopes[0, 0], strict=True) if v]
        raise ConfigError(
            f"the input {entry} as a force on {coordinate}: d {rates[coordinate]}' / d {entry} is "
            f"{slopes[0, 0, row]:.3g}",
            f"one that pushes {coordinate} along; this one acts on {', '.join(moved) or 'none'}",
        )
