"""From a machine, a case and a seed to a question: records, a wrong nominal model, candidates."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import numpy as np

from experiments.studies.pieces import version
from experiments.studies.question import Question, misjudged, model_of
from experiments.studies.trajectory import trajectory
from experiments.zoo.machine import Machine
from experiments.zoo.truth import MACHINES
from spiral.io.registry import Registry, load_registry
from spiral.types.model import Model
from spiral.types.record import Record, make_record
from spiral.types.system import System

HERE = Path(__file__).parent
SYSTEMS = HERE / "systems"
SALT = "zoo of 2026"  # chosen before any study was run; see ``half``


@cache
def registry() -> Registry:
    """The shipped plugins and the zoo's, as a user's folder."""
    return load_registry(SYSTEMS)


def half(name: str) -> str:
    """``tune`` or ``report``, by the parity of the SHA-256 of the name."""
    digest = hashlib.sha256(f"{SALT} {name}".encode()).digest()
    return ("tune", "report")[digest[0] % 2]


def system_of(machine: Machine) -> System:
    """The plugin of a machine."""
    made = registry().make("system", machine.system, dict(machine.fields))
    assert isinstance(made, System)
    return made


def truth_of(machine: Machine, case: str) -> Model:
    """The plugin's model with what is hidden, for the check of the equations by hand."""
    hidden = machine.hidden(case)
    model = model_of(system_of(machine), machine.values, machine.free)
    for label in dict.fromkeys(k.rsplit(".", 1)[0] for k in hidden):
        own = {k: v for k, v in hidden.items() if k.rsplit(".", 1)[0] == label}
        model = model.add(registry().effect_from_label(label), own)
    return model


def states_of(machine: Machine, case: str) -> tuple[str, ...]:
    """Names of all states in order, those of the hidden effect last."""
    from spiral.physics.trace import own_states

    model = truth_of(machine, case)
    own = own_states(model.system, model.effects)
    return (*(s.name for s in model.system.states), *own)


def motion(
    machine: Machine,
    case: str,
    seed: int,
    number: int,
    tolerance: float = 1e-9,
    part: float = 1.0,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """True states (samples, n) and sampled inputs of the first ``part`` of one record of a seed."""
    rng = np.random.default_rng([seed, number])
    time, names = machine.time(), states_of(machine, case)
    time = time[: round(part * len(time))]
    signals = machine.excite(rng, machine.duration)
    share = 1.0 + machine.spread * rng.uniform(-1.0, 1.0, len(names))
    start = np.array([machine.start.get(n, 0.0) for n in names]) * share
    values = {**machine.values, **machine.hidden(case)}
    states = trajectory(machine.rate, start, time, signals, values, tolerance)
    return states, {k: np.broadcast_to(s(time), time.shape).copy() for k, s in signals.items()}


def record_of(machine: Machine, case: str, seed: int, number: int) -> Record:
    """A record as measured: what the sensors see, with noise that nobody declares."""
    states, inputs = motion(machine, case, seed, number)
    system, names = system_of(machine), states_of(machine, case)
    rng = np.random.default_rng([seed, number, 1])
    channels = {}
    for name in system.observed:
        clean = states[:, names.index(name)]
        channels[name] = clean + rng.normal(0.0, machine.noise * np.std(clean), len(clean))
    inputs = {i.name: inputs[i.name] for i in system.inputs}
    kept = {k: states[:, i] for i, k in enumerate(names)}
    told = f"{machine.name}, record {number + 1} of seed {seed}"
    return make_record(system, told, machine.time(), channels, inputs, truth=kept)


def question(name: str, case: str, seed: int) -> Question:
    """What a user asks about a machine of the zoo."""
    machine = MACHINES[name]
    system = system_of(machine)
    known = model_of(system, machine.values, machine.free)
    wrong = misjudged(known, np.random.default_rng([seed, 99]))
    records = tuple(record_of(machine, case, seed, i) for i in range(machine.records + 1))
    hidden = machine.hidden(case)
    return Question(
        system,
        records[:-1],
        records[-1:],
        {
            "values": {**known.values, **wrong},
            "free": machine.free,
            "candidates": [
                e
                for e in registry().candidates(system, everywhere=True)
                if e.label not in known.labels
            ],
            "plugins": registry(),
        },
        tuple(dict.fromkeys(k.rsplit(".", 1)[0] for k in hidden)),
        {**machine.values, **hidden},
        floor=machine.noise,
    )


def definition(name: str) -> str:
    """The version of a machine: its two files and what makes records of it."""
    machine = MACHINES[name]
    own = HERE / "truth" / f"{machine.rate.__module__.rsplit('.', 1)[1]}.py"
    plugin = Path(registry().entry("system", machine.system).file)
    shared = (HERE.parent / "studies" / n for n in ("signals.py", "trajectory.py", "question.py"))
    return version(plugin, own, HERE / "cases.py", HERE / "machine.py", *shared)
