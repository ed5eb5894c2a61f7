"""Records and problems that several tests share: each is one simulated machine."""

from dataclasses import replace
from functools import cache

import numpy as np
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.strategies.shooting import Shooting
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.problem import Problem, Settings
from spiral.inference.simulate import simulate
from spiral.io.registry import load_registry
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.effect import Effect
from spiral.types.model import Model, seed_model

SEED_TRUTH = {
    "linear_stiffness.stiffness_x": 8085.0,
    "linear_stiffness.stiffness_y": 9672.0,
    "linear_damping.damping_x": 3.5,
    "linear_damping.damping_y": 2.1,
    "unbalance.moment": 1.565e-5,
}

# Leading-order projection of the tilting rotor onto x and y, per unit mass (design, fact 3).
PROJECTION = {
    "linear_stiffness.stiffness_x": 8085.0,
    "linear_stiffness.stiffness_y": 9672.0,
    "cross_stiffness.stiffness": 1105.0,
    "cubic_stiffness.stiffness": 3.393e10,
    "unbalance.moment": 1.565e-5,
    "gyroscopic.coefficient": 4.80e-3,
}


@cache
def registry():
    """The shipped plugins, read once: nothing changes a registry."""
    return load_registry(None)


def effect(label: str, **fields) -> Effect:
    return registry().effect_from_label(label, fields)


def planar_record(
    seed: int,
    effects: tuple[Effect, ...] = (),
    values: dict[str, float] | None = None,
    phase: float = 0.4,
    noise: float = 0.02,
    duration: float = 14.0,
    hertz: tuple[float, float] = (40.0, 0.0),
    with_phase: bool = True,
):
    """A run-down of the planar rotor itself: the truth lies inside the model class."""
    base = seed_model(PlanarRotor())
    truth = {**SEED_TRUTH, **(values or {}), "system.phase_origin": phase}
    model = Model(base.system, (*base.effects, *effects), truth)
    time = 1e-3 * np.arange(round(duration * 1000) + 1)
    speed = 2 * np.pi * (hertz[0] + (hertz[1] - hertz[0]) * time / duration)
    slope = 2 * np.pi * (hertz[1] - hertz[0]) / duration
    inputs = {"speed": speed}
    if with_phase:
        inputs["phase"] = speed[0] * time + slope * time**2 / 2
    rng = np.random.default_rng(seed)
    return simulate(model, time, inputs, noise, rng, substeps=2)


def candidates(model: Model) -> tuple[Effect, ...]:
    return tuple(e for e in registry().candidates(model.system) if e.label not in model.labels)


def planar_problem(record, test, model: Model | None = None, **settings) -> Problem:
    model = model or seed_model(PlanarRotor())
    return Problem(
        model,
        (record,),
        (test,),
        candidates=candidates(model),
        settings=Settings(**settings),
        strategy=Shooting(),
    )


# A stretch of the run-down that shows every hidden effect in a third of the samples.
BRIEF = {"duration": 5.0, "start_hz": 30.0, "stop_hz": 10.0}


@cache
def coastdown_problem(seed: int = 11, **fields) -> Problem:
    """The embedded record, as ``experiment=rotor_coastdown`` makes it."""
    model = seed_model(PlanarRotor())
    source = RotorCoastdown(seed=seed, **fields)
    test = replace(source, seed=1011, phase=1.3)
    return planar_problem(source.load(model.system)[0], test.load(model.system)[0], model)


def admitted(run) -> list[str]:
    return [label for r in run.rounds[1:] for label in r.admitted]


def evaluated(model, effects=(), values=None, at=None):
    """(f, f_x, f_p) of a compiled model at states, inputs (time last) and parameters."""
    traced = trace(model, effects)
    compiled = compile_model(traced)
    known = {k: q.start for k, q in zip(traced.keys, traced.parameters, strict=True)}
    known |= {**model.defaults, **(values or {})}
    x, u = at
    p = np.array([known[k] for k in traced.keys], dtype=float)
    n = len(traced.x)
    f, a, b = np.empty(n), np.zeros((n, n)), np.zeros((n, len(p)))
    compiled.rate(np.array(x, dtype=float), np.array(u, dtype=float), p, f, a, b)
    return f, a, b
