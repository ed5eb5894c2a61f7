"""Make a record from a model: the truth of an experiment, or a planned test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from spiral.engine.kernel import trajectories
from spiral.engine.resting import state_jacobian
from spiral.engine.series import stable_steps, stage_inputs
from spiral.physics.compile import compile_model
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError
from spiral.types.model import Model
from spiral.types.record import Array, Record, make_record

SUBSTEPS = 8  # integration steps per sample


def simulate(
    model: Model,
    time: Array,
    inputs: Mapping[str, Array],
    noise_level: float = 0.0,
    rng: np.random.Generator | None = None,
    start: Mapping[str, float] | None = None,
    name: str = "simulated",
    substeps: int = SUBSTEPS,
) -> Record:
    """Integrate x' = f(x, u, p) by classical Runge-Kutta and read the sensors.

    Parameters
    ----------
    model : the truth; every parameter needs a value.
    time : uniform, s. inputs : by name, in the system's units; a missing phase is the integral of
        speed.
    noise_level : white Gaussian noise as a share of each channel's standard deviation; the record
        declares it.
    start : initial states by name; where not named, as the system declares (zero). An effect's own
        state that follows a sensor or an input (``like``) begins at what is there.
    substeps : integration steps per sample, or more where the model is stiff at its start.

    Raises
    ------
    ConfigError : a parameter without a value, an unknown state, or a motion that diverges.
    """
    states, readings = integrate(model, time, inputs, start, substeps)
    channels = {c: readings[:, j] for j, c in enumerate(model.system.observed)}
    truth = {s.name: states[:, i] for i, s in enumerate(model.system.states)}
    noise: dict[str, float] = {}
    if noise_level > 0:
        generator = rng if rng is not None else np.random.default_rng(0)
        noise = {c: noise_level * float(np.std(v)) for c, v in channels.items()}
        channels = {c: v + generator.normal(0.0, noise[c], len(v)) for c, v in channels.items()}
    return make_record(model.system, name, time, channels, inputs, noise, truth)


def integrate(
    model: Model,
    time: Array,
    inputs: Mapping[str, Array],
    start: Mapping[str, float] | None = None,
    substeps: int = SUBSTEPS,
) -> tuple[Array, Array]:
    """Noise-free states (samples, n) and readings (samples, channels)."""
    compiled = compile_model(trace(model.system, model.effects))
    values = model.row("truth", "for instance record.values='{{{}: 1.0}}'")
    quiet = np.random.default_rng(0).normal(size=(len(model.system.observed), len(time)))
    frame = make_record(  # checks the inputs and derives what is missing
        model.system, "planned", time, dict(zip(model.system.observed, quiet, strict=True)), inputs
    )
    x = np.zeros(len(compiled.traced.states))
    for key, value in (start or {}).items():
        if key not in compiled.traced.states:
            raise ConfigError(
                f"initial state {key!r}", f"one of {', '.join(compiled.traced.states)}"
            )
        x[compiled.traced.states.index(key)] = value
    stepped = stage_inputs(model.system, frame, substeps)
    known = {s.name for s in model.system.states if not s.start} | set(start or {})
    fill_declared_starts(compiled.traced, x, stepped[0], known=known)
    modes = np.linalg.eigvals(state_jacobian(compiled, values, stepped.mean(axis=0), x))
    if (needed := stable_steps(modes, frame.dt)) > substeps:
        substeps, stepped = needed, stage_inputs(model.system, frame, needed)
    states = np.empty((len(time), len(x)))
    readings = np.empty((len(time), len(model.system.observed)))
    ok = trajectories(
        compiled.rate_value, compiled.output_value, x[None, :], np.zeros(1, dtype=np.int64),
        np.array([len(time)]), values[None, :], stepped, substeps, frame.dt, states, readings,
    )  # fmt: skip
    if not ok:
        raise ConfigError(
            "a simulation that grows without bound",
            "parameters of a stable motion",
            "check signs and sizes of the parameters, or simulate a shorter time",
        )
    return states, readings


def with_defaults(model: Model) -> Model:
    """The model with its system's nominal values where none are given."""
    known = {k for k, _ in model.pairs}
    nominal = {k: v for k, v in model.system.defaults.items() if k in known}
    return replace(model, values={**nominal, **model.values})
