"""Which bearing carries the nonlinear stiffness: judged by the likelihood of the innovations.

python -m experiments.hidden_states.which_bearing [--seeds 5]

The truth has a cubic spring in bearing 2 only; linear part and phase known, 2 % noise. The filter
tracks the cubic stiffness of bearing 1, of bearing 2, or of both as a state that starts at zero
with a wide doubt: its log-likelihood is then the evidence for that placement.
"""

from __future__ import annotations

import argparse

import numpy as np
from spiral_plugins.observers.kalman import Ekf
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.filtering.task import Task, prepare_task, with_record
from spiral.model import seed_model
from spiral.simulate import with_defaults

TRUTH = 3.122e11  # N/m^3
KEYS = tuple(f"cubic_stiffness@bearing_{i}.stiffness" for i in (1, 2))
PLACES = {"neither": (), "bearing 1": KEYS[:1], "bearing 2": KEYS[1:], "both": KEYS}


def task(seed: int, base: Task | None) -> Task:
    """One record, and the model without cubic springs."""
    system = TiltingRotor()
    source = Simulation(
        system=system,
        values={KEYS[0]: 0.0, KEYS[1]: TRUTH},
        inputs={"speed": {"sweep": [40, 0], "unit": "Hz"}},
        duration=14.0,
        seed=seed,
    )
    record = source.load(system)[0]
    if base is not None:
        return with_record(base, record)
    model = with_defaults(seed_model(system, values=dict.fromkeys(KEYS, 0.0)))
    return prepare_task(model, record)


def main() -> None:
    """Print log-likelihoods over that of no cubic spring, and the stiffness found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    base = None
    for seed in range(1, given.seeds + 1):
        base = task(seed, base)
        nothing = np.nan
        for place, keys in PLACES.items():
            doubt = dict.fromkeys(keys, 2 * TRUTH)
            found = Ekf(process_noise=1e-3, track=keys, doubt=doubt).reconstruct(base)
            nothing = found.log_likelihood if place == "neither" else nothing
            sizes = ", ".join(
                f"{found.state(k)[0][-1]:.4g} ± {found.state(k)[1][-1]:.2g}" for k in keys
            )
            gain = found.log_likelihood - nothing
            print(f"seed {seed}  {place:<10} log-likelihood {gain:>+14.1f}  {sizes}", flush=True)


if __name__ == "__main__":
    main()
