"""The zoo's machines: equations written twice agree, and what is hidden is of practical size."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from experiments.studies.trajectory import Values
from experiments.zoo.cases import half, motion, registry, states_of, system_of, truth_of
from experiments.zoo.machine import HIDDEN, NULL
from experiments.zoo.truth import MACHINES
from spiral.inference.simulate import integrate
from spiral.physics.trace import trace
from tests.marks import others_slow

EVERY = [(m.name, case) for m in MACHINES.values() for case in m.effects]
EASY_FIRST = sorted(EVERY, key=lambda each: each[1] != HIDDEN)


def test_the_zoo_has_its_size():
    assert len(MACHINES) >= 20
    assert len({m.topic for m in MACHINES.values()}) >= 6
    assert not registry().failures
    assert all(HIDDEN in m.effects and NULL in m.cases for m in MACHINES.values())


def test_the_halves_are_fixed():
    """By the name alone: whatever joins the zoo later leaves the others where they are."""
    tune = sorted(n for n in MACHINES if half(n) == "tune")
    assert {"ball_and_beam", "belt_drive", "neuron"} <= set(tune)
    assert 8 <= len(tune) <= len(MACHINES) - 8


@pytest.mark.parametrize(("name", "case"), EVERY)
def test_the_equations_by_hand_are_those_of_the_plugin(name, case):
    """x' at random states and inputs, to 1e-9 of what each state's rate shows."""
    machine = MACHINES[name]
    model = truth_of(machine, case)
    traced = trace(model.system, model.effects)
    rate = sp.lambdify((traced.x, traced.u, traced.p), traced.rate, "numpy")
    given = {k: p.start for k, p in model.pairs} | dict(model.values)
    p = [given[k] for k in traced.keys]
    rng = np.random.default_rng(5)
    size = _sizes(machine, case)
    values = Values({**machine.values, **machine.hidden(case)})
    found, wanted = [], []
    for _ in range(20):
        time = rng.uniform(0.1, 0.9) * machine.duration
        now = {k: float(s(time)) for k, s in machine.excite(rng, machine.duration).items()}
        x = size * rng.uniform(-1.0, 1.0, len(size))
        if machine.topic == "biology":  # nothing negative grows
            x = np.abs(x)
        u = [time if n == "time" else now[n] for n in traced.inputs]
        found.append(rate(x, u, p))
        wanted.append(machine.rate(x, SimpleNamespace(time=time, **now), values))
    found, wanted = np.array(found, float), np.array(wanted, float)
    assert np.all(np.abs(found - wanted) <= 1e-9 * np.abs(wanted).max(axis=0))


def _sizes(machine, case):
    """Largest value of each state in the first record, coarsely."""
    states, _ = motion(machine, case, 0, 0, 1e-4, 0.05)
    return np.abs(states).max(axis=0)


@pytest.mark.parametrize(("name", "case"), others_slow(EASY_FIRST, len(MACHINES) // 2))
def test_what_is_hidden_is_seen_and_does_not_rule(name, case):
    """The first third of a record, a rotor's until its resonance is passed; 2 to 60 % there."""
    part = 0.7 if MACHINES[name].topic == "rotors" else 0.33
    assert 0.02 <= _share(name, case, part) <= 0.6


@pytest.mark.slow
@pytest.mark.parametrize(("name", "case"), EVERY)
def test_what_is_hidden_changes_the_response_by_5_to_40_percent(name, case):
    assert 0.05 <= _share(name, case, 1.0) <= 0.4


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_the_package_simulates_the_true_motion(name):
    """Its own integrator, on the plugin's model: nearer to the truth than a tenth of the noise."""
    machine = MACHINES[name]
    names, model = states_of(machine, HIDDEN), truth_of(machine, HIDDEN)
    states, inputs = motion(machine, HIDDEN, 0, 0, 1e-8, 0.3)
    given = {i.name: inputs[i.name] for i in model.system.inputs}
    time = machine.time()[: len(states)]
    start = dict(zip(names, states[0], strict=True))
    simulated, _ = integrate(model, time, given, start, substeps=16)
    for channel in model.system.observed:
        column = names.index(channel)
        true = states[:, column]
        miss = np.sqrt(np.mean((simulated[:, column] - true) ** 2))
        assert miss <= 0.1 * machine.noise * true.std()


def _share(name, case, part):
    """Rms of the change over the standard deviation of the response, mean over channels."""
    machine = MACHINES[name]
    names, system = states_of(machine, case), system_of(machine)
    seen = [names.index(c) for c in system.observed]
    hidden, plain = (motion(machine, c, 0, 0, 1e-4, part)[0][:, seen] for c in (case, NULL))
    assert np.all(np.isfinite(hidden))
    share = np.sqrt(np.mean((hidden - plain) ** 2, axis=0)) / plain.std(axis=0)
    return share.mean()
