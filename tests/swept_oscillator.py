"""An oscillator of 3.2 Hz swept through its resonance, for tests of the likelihood."""

import numpy as np
from spiral_plugins.systems.oscillator import Oscillator

from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task, run_from
from spiral.inference.simulate import simulate
from spiral.types.model import seed_model

TRUTH = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 0.8}
RATE = 200.0
KEYS = tuple(TRUTH)


def record_of(seed, samples=1500, noise=0.05, effects=(), values=None):
    """An oscillator of 3.2 Hz swept from 1 to 7 Hz, with white noise that nobody declares."""
    model = seed_model(Oscillator(), effects, values={**TRUTH, **(values or {})})
    time = np.arange(samples) / RATE
    force = 30 * np.sin(2 * np.pi * (1 + 3 * time / time[-1]) * time)
    return simulate(model, time, {"force": force}, noise, np.random.default_rng(seed))


def task_of(record, effects=(), values=None, substeps=4):
    model = seed_model(Oscillator(), effects, values={**TRUTH, **(values or {})})
    return prepare_filter(prepare_task(model, record, substeps=substeps, every=True), ())


def states_alone(task, settings):
    """The model's motion from the filter's first mean, without measurements."""
    return run_from(task, settings.start)


def shaken(seed, level):
    from spiral.engine.filter.stochastic import simulate_disturbed

    task, _ = task_of(record_of(seed, samples=1500, noise=0.0))
    return simulate_disturbed(task, {"observed": level}, 0.02, np.random.default_rng(seed))


def relaxed(rng, count, keep):
    """Noise of variance one that keeps this share of itself from sample to sample."""
    steps = rng.normal(size=count) * np.sqrt(1 - keep**2)
    noise = np.empty(count)
    noise[0] = rng.normal()
    for k in range(1, count):
        noise[k] = keep * noise[k - 1] + steps[k]
    return noise


def unfitted(record, values=None):
    """A study of the oscillator and its state, nothing fitted."""
    from spiral.inference.evidence.assembly import compile_assembly
    from spiral.inference.evidence.fit_state import FitState, initial_values
    from spiral.inference.problem import Problem

    model = seed_model(Oscillator(), values={**TRUTH, **(values or {})})
    assembly = compile_assembly(Problem(model, (record,), ()), (), 4)
    return assembly, FitState(model.labels, initial_values(assembly), corrected=False)
