"""Bands of hidden states of machines with drawn parameters, other than the rotor.

python -m experiments.hidden_states.other_machines [--seeds 20]

Four masses of which the second and the fourth are hidden (stiffnesses and dampings drawn with
10 %), and two tanks of which the upper is hidden (pump and outlets drawn with 10 %). The model has
the nominal values, with and without declared doubt; the first states are known to a fifth of their
settled deviation.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from spiral_plugins.observers.kalman import Rts
from spiral_plugins.systems.cascaded_tanks import CascadedTanks

from experiments.zoo.systems.four_masses import FourMasses
from spiral.engine.filter.task import prepare_task
from spiral.inference.reconstruction.estimate import combine_reconstructions, reconstruct_record
from spiral.inference.reconstruction.uncertain import declared_prior
from spiral.inference.simulate import simulate
from spiral.types.model import seed_model
from spiral.types.record import Array
from spiral.types.system import System

DOUBT, START = 0.1, 0.2
_LINKS = ("", "@link_12", "@link_23", "@link_34")


@dataclass(frozen=True)
class Drawn:
    """A machine: nominal values of what is drawn, values that are known, and its record."""

    system: System
    nominal: Mapping[str, float]
    known: Mapping[str, float]
    time: Array
    inputs: Callable[[np.random.Generator, Array], dict[str, Array]]
    hidden: tuple[str, ...]
    start: Mapping[str, float]
    noise: float = 0.02


def _force(rng: np.random.Generator, time: Array) -> dict[str, Array]:
    """Sixteen sines between 1 and 12 Hz, phases drawn."""
    phases = rng.uniform(0, 2 * np.pi, 16)
    waves = np.sin(2 * np.pi * np.linspace(1, 12, 16)[:, None] * time + phases[:, None])
    return {"force": 20.0 * waves.sum(axis=0)}


def _pump(rng: np.random.Generator, time: Array) -> dict[str, Array]:
    """Steps of 200 s between 2 and 5 V."""
    steps = rng.uniform(2.0, 5.0, len(time) // 50 + 1)
    return {"pump": np.repeat(steps, 50)[: len(time)]}


MACHINES = {
    "four masses": Drawn(
        FourMasses(),
        {f"linear_stiffness{k}.stiffness": 2000.0 for k in _LINKS}
        | {f"linear_damping{k}.damping": 2.0 for k in _LINKS},
        {"system.mass": 1.0},
        0.005 * np.arange(2000), _force, ("x2", "x4"), {},
    ),
    "two tanks": Drawn(
        CascadedTanks(),
        {"pump.gain": 0.05, "outlets.upper": 0.06, "outlets.lower": 0.055},
        {"outlets.width": 1e-3},
        4.0 * np.arange(1000), _pump, ("upper",), {"upper": 4.0, "lower": 4.0},
    ),
}  # fmt: skip


def outcome(machine: Drawn, seed: int, doubt: float) -> dict[str, tuple[float, float]]:
    """Hidden state -> relative error, and share of samples in the 95 % band."""
    rng = np.random.default_rng([seed, 79])
    true = {k: v * (1 + DOUBT * rng.normal()) for k, v in machine.nominal.items()}
    truth = seed_model(machine.system, values={**true, **machine.known})
    record = simulate(truth, machine.time, machine.inputs(rng, machine.time), machine.noise, rng,
                      machine.start)  # fmt: skip
    model = seed_model(machine.system, values={**machine.nominal, **machine.known})
    task = prepare_task(model, record)
    first = np.array([record.truth[s][0] for s in task.states])
    task = replace(task, start=first + START * task.spread * rng.normal(size=len(first)))
    if doubt:
        task = replace(
            task, prior=declared_prior(model, task, dict.fromkeys(machine.nominal, doubt))
        )
    states = combine_reconstructions("rts", [reconstruct_record(task, Rts(spread=START))]).states
    return {s: (states[s].relative or 0.0, states[s].coverage_95 or 0.0) for s in machine.hidden}


def main() -> None:
    """One line for each machine, hidden state and doubt."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="machines that are drawn of each")
    parser.add_argument("--only", choices=tuple(MACHINES), help="one of them")
    given = parser.parse_args()
    for name, machine in MACHINES.items():
        for doubt in (0.0, DOUBT) if given.only in (None, name) else ():
            rows = [outcome(machine, seed, doubt) for seed in range(given.seeds)]
            for state in machine.hidden:
                error, held = np.array([row[state] for row in rows]).T
                said = f"error {100 * np.median(error):.3g} %, held {100 * held.mean():.1f} %"
                print(f"{name:<12} {state:<6} declared {doubt:<4} {said}", flush=True)


if __name__ == "__main__":
    main()
