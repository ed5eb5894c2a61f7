"""Scales of a machine that falls out of step when it is begun from rest."""

import numpy as np
import pytest

import spiral
from spiral.inference.evidence.assembly import compile_assembly
from spiral.inference.evidence.fit_state import FitState, initial_values
from spiral.inference.likelihood.fitting import prepare_filter_tasks
from spiral.inference.problem import Problem
from spiral.types.model import seed_model
from spiral.types.record import make_record

MACHINE = {
    "equations": ["d' = wb*w", "2*H*w' = Pm - Pe*sin(d) - D*w"],
    "states": {"d": "rad", "w": "1"},
    "inputs": {"Pm": "1"},
    "parameters": {"wb": "314 rad/s", "H": "3.5 s", "D": "2.0", "Pe": "1.0"},
    "free": ["H", "D", "Pe"],
    "observed": ["P = Pe*sin(d)", "w"],
}
TRUE = {"system.wb": 314.0, "system.H": 3.5, "system.D": 2.0, "system.Pe": 1.0}


@pytest.fixture(scope="module")
def study():
    """A generator on a strong grid (its angle hidden), and how its states moved."""
    rng = np.random.default_rng(2)
    time = np.arange(1500) * 0.02
    steps = np.repeat(rng.uniform(0.75, 0.85, 30), 50)
    power = np.convolve(np.pad(steps, 12, mode="edge"), np.ones(25) / 25, "valid")
    fine, at = 20, [np.arcsin(power[0]), 0.0]
    states = [at]
    for u in np.repeat(power[:-1], fine):
        d, w = at
        w += 0.02 / fine * (u - np.sin(d) - 2.0 * w) / 7.0  # symplectic: stable where it swings
        at = [d + 0.02 / fine * 314 * w, w]
        states.append(at)
    moved = np.array(states)[::fine]
    readings = {"P": np.sin(moved[:, 0]), "w": moved[:, 1]}
    noisy = {k: v + 0.01 * v.std() * rng.normal(size=len(v)) for k, v in readings.items()}
    system = spiral.system(MACHINE)
    record = make_record(system, "generator", time, noisy, {"Pm": power})
    assembly = compile_assembly(Problem(seed_model(system, values=TRUE), (record,), ()), (), 2)
    return assembly, FitState((), initial_values(assembly), corrected=False), moved


def test_the_free_run_from_rest_is_known_to_be_astray(study):
    assembly, state, moved = study
    ((task, _),) = prepare_filter_tasks(assembly, state)
    assert task.astray
    assert np.ptp(moved[:, 0]) < 2.0  # the machine itself stays in step


def test_scales_are_those_of_the_motion_that_a_filter_tracks(study):
    """Within a factor of three, where those of the free run are hundreds of times too large."""
    assembly, state, moved = study
    ((task, _),) = prepare_filter_tasks(assembly, state)
    assert task.scales == pytest.approx(moved.std(axis=0), rel=2.0)
    assert np.all(task.scales > moved.std(axis=0) / 3)
    own = np.gradient(moved, 0.02, axis=0).std(axis=0)
    assert np.all((own / 4 < task.rates) & (task.rates < 4 * own))
