"""Many motions of one model at once: other inputs, starts or values in each, on one device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spiral.engine.batch import find_device, integrate_batch
from spiral.engine.batch_inputs import InputColumn, lay_out_inputs
from spiral.inference.simulate import SUBSTEPS
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import TracedModel, trace
from spiral.types.batch import Batch
from spiral.types.clock import MINIMUM_SAMPLES
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.model import Model
from spiral.types.record import Array

Varied = Mapping[str, Any]


def simulate_batch(
    model: Model,
    time: Array,
    inputs: Varied,
    values: Varied | None = None,
    start: Varied | None = None,
    slopes: Sequence[str] = (),
    device: str | None = None,
    substeps: int = SUBSTEPS,
) -> Batch:
    """Integrate x' = f(x, u, p) for every simulation as ``simulate.integrate`` does for one.

    Parameters
    ----------
    model : every parameter needs a value, here or in ``values``.
    time : (samples,) uniform, s. inputs : by name, (samples,) or (simulations, samples).
    values, start : parameters by full name and initial states, a number or (simulations,) each.
    slopes : parameters and initial states that d reading is wanted by.
    device : ``cpu``, ``gpu``, ``gpu:1``; JAX's first where left out.
    substeps : integration steps per sample.

    Raises
    ------
    ConfigError : an unknown name, shapes that do not fit, a value that is missing, no JAX.
    PluginError : an equation that JAX cannot run.
    """
    traced = trace(model.system, model.effects)
    chosen = find_device(device)
    given = _check_inputs(model, inputs, len(time))
    varied = _check_numbers("value of", values or {}, traced.keys)
    starts = _check_numbers("initial state", start or {}, traced.states)
    _check_names("slopes by", slopes, (*traced.keys, *traced.states))
    count = _simulations({"input": given, "value": varied, "initial state": starts})
    columns = lay_out_inputs(model.system, time, given, substeps, _used_columns(traced))
    step = (time[-1] - time[0]) / (len(time) - 1)
    motion = integrate_batch(
        traced, _initial_states(model, traced, starts, columns, given, count),
        _parameter_rows(model, varied, traced.keys), columns, len(time), step, substeps,
        slopes, chosen,
    )  # fmt: skip
    by = {k: np.stack([s[..., i] for s in motion.slopes], -1) for i, k in enumerate(slopes)}
    return Batch(
        time[0] + step * np.arange(len(time)),
        dict(zip(traced.channels, motion.readings, strict=True)),
        dict(zip(traced.states, motion.states, strict=True)),
        motion.diverged, f"{chosen.platform}:{chosen.id} ({chosen.device_kind})", by,
    )  # fmt: skip


def _check_names(what: str, names: Sequence[str] | Varied, known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            told = f"one of {', '.join(known) or 'none'}"
            raise ConfigError(f"{what} {name!r}", told, did_you_mean(name, known))


def _check_inputs(model: Model, inputs: Varied, samples: int) -> dict[str, Array]:
    """Inputs by name, (samples,) or (simulations, samples), finite and complete."""
    system = model.system
    _check_names("input", inputs, [i.name for i in system.inputs])
    missing = [i.name for i in system.inputs if i.name not in inputs and i.derived_from is None]
    if missing:
        raise ConfigError(
            f"inputs {', '.join(inputs) or 'none'}",
            f"also {', '.join(missing)}, of system {system.plugin_name()!r}",
        )
    if samples < MINIMUM_SAMPLES:
        raise ConfigError(f"{samples} samples", f"at least {MINIMUM_SAMPLES}")
    known = {name: np.asarray(v, dtype=float) for name, v in inputs.items()}
    known = {k: np.full(samples, v) if v.ndim == 0 else v for k, v in known.items()}
    for name, v in known.items():
        if v.ndim > 2 or v.shape[-1] != samples or not v.size:
            raise ConfigError(
                f"input {name!r} of shape {v.shape}",
                f"({samples},) for all simulations alike, or (simulations, {samples})",
                "transpose it, or change duration or rate" if samples in v.shape else "",
            )
        _check_finite(f"input {name!r}", v)
    return known


def _check_numbers(what: str, given: Varied, known: Sequence[str]) -> dict[str, Array]:
    """Numbers by name, () or (simulations,)."""
    _check_names(what, given, known)
    numbers = {name: np.asarray(v, dtype=float) for name, v in given.items()}
    for name, v in numbers.items():
        if v.ndim > 1 or not v.size:
            raise ConfigError(f"{what} {name!r} of shape {v.shape}", "a number, or (simulations,)")
        _check_finite(f"{what} {name!r}", v)
    return numbers


def _check_finite(what: str, values: Array) -> None:
    if not np.all(np.isfinite(values)):
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise ConfigError(f"{what} with {values[place]} at {place}", "finite numbers")


def _simulations(groups: Mapping[str, Mapping[str, Array]]) -> int:
    """The number of simulations, which all that differs between them has in common."""
    counts: dict[int, str] = {}
    for what, group in groups.items():
        for name, values in group.items():
            if values.ndim == (2 if what == "input" else 1):
                counts.setdefault(len(values), f"{what} {name!r}")
    if len(counts) > 1:
        told = ", ".join(f"{name} of {count} simulations" for count, name in counts.items())
        raise ConfigError(told, "one number of simulations for all that differs between them")
    return next(iter(counts), 1)


def _used_columns(traced: TracedModel) -> frozenset[str]:
    """Input columns that an equation or a state's start has."""
    symbols = frozenset().union(*(e.free_symbols for e in (*traced.rate, *traced.output)))
    used = {n for n, symbol in zip(traced.inputs, traced.u, strict=True) if symbol in symbols}
    return frozenset(used)


def _parameter_rows(model: Model, varied: Mapping[str, Array], keys: Sequence[str]) -> list[Array]:
    """Values of all parameters in their order, () or (simulations,) each."""
    first = {name: float(v.flat[0]) for name, v in varied.items()}
    complete = Model(model.system, model.effects, {**model.values, **first})
    row = complete.row("model", "for instance values={{'{}': 1.0}}")
    return [varied.get(key, value) for key, value in zip(keys, row, strict=True)]


def _initial_states(
    model: Model, traced: TracedModel, starts: Mapping[str, Array],
    columns: Sequence[InputColumn], inputs: Mapping[str, Array], count: int,
) -> Array:  # fmt: skip
    """(simulations, states) where not named: as declared, an effect's own at what it follows."""
    x = np.zeros((count, len(traced.states)))
    for name, values in starts.items():
        x[:, traced.states.index(name)] = values
    first = np.zeros((count, len(columns)))
    for place, (name, column) in enumerate(zip(traced.inputs, columns, strict=True)):
        first[:, place] = inputs[name][..., 0] if name in inputs else column.first
    known = {s.name for s in model.system.states if not s.start} | set(starts)
    fill_declared_starts(traced, x, first, known=known)
    return x
