"""Calibrate the bearings from x and y, beside the Cramer-Rao bound; then reconstruct.

python -m experiments.hidden_states.calibration [--seeds 20] [--records 1] [--jobs 2] [--json FILE]

Every bearing parameter starts 10 % off with a sign of its own; the calibrated model then meets a
record with other noise. Beside it one common factor, from 20 % off.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from spiral_plugins.observers.kalman import Ekf
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.inference.problem import Problem
from spiral.inference.reconstruction.calibrate import calibrate, cramer_rao
from spiral.inference.reconstruction.estimate import estimate
from spiral.inference.simulate import with_defaults
from spiral.types.model import Model, seed_model
from spiral.types.record import Record

SYSTEM = TiltingRotor()
TRUE = with_defaults(seed_model(SYSTEM))
BEARINGS = tuple(k for k in TRUE.values if "@bearing" in k)


def records(first: int, count: int) -> tuple[Record, ...]:
    """Records of one machine, the noise of each its own."""
    return tuple(RotorCoastdown(seed=first + i).load(SYSTEM)[0] for i in range(count))


def outcome(seed: int, count: int) -> dict[str, Any]:
    """One calibration of all parameters and one of the common factor, and what they are worth."""
    clock = time.perf_counter()
    signs = np.random.default_rng([seed, 5]).choice((-1.0, 1.0), len(BEARINGS))
    given = records(1000 * seed, count)
    free = calibrate(Problem(_wrong(0.1 * signs), given, ()))
    taken = time.perf_counter() - clock
    common = calibrate(Problem(_wrong(0.2 + 0 * signs), given, ()), together=BEARINGS)
    fresh = RotorCoastdown(seed=1000 * seed + 999, rate=2000.0).load(SYSTEM)
    return {
        "seed": seed,
        "records": count,
        "converged": free.converged,
        "seconds": taken,
        "error": {k: free.model.values[k] - TRUE.values[k] for k in free.model.errors},
        "se": dict(free.model.errors),
        "not_told": list(free.untold),
        "factor": common.model.values[BEARINGS[0]] / TRUE.values[BEARINGS[0]],
        "tilt": {k: _tilt(m, fresh) for k, m in (("all", free.model), ("factor", common.model))},
    }


def _wrong(shares: np.ndarray) -> Model:
    wrong = {k: TRUE.values[k] * (1 + s) for k, s in zip(BEARINGS, shares, strict=True)}
    return replace(TRUE, values={**TRUE.values, **wrong})


def _tilt(model: Model, fresh: tuple[Record, ...]) -> list[float | None]:
    """Relative errors of alpha and beta on a record that the calibration has not seen."""
    found = estimate([replace(model, errors={})], fresh, Ekf(process_noise=1e-3))
    return [found.states[s].relative for s in ("alpha", "beta")]


def main() -> None:
    """Run the seeds in parallel and print errors over the bound."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--records", type=int, default=1, help="records of each calibration")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--json", help="file for the rows")
    given = parser.parse_args()
    bound = cramer_rao(Problem(TRUE, records(0, given.records), ()))
    jobs = [delayed(outcome)(s + 1, given.records) for s in range(given.seeds)]
    rows = Parallel(n_jobs=given.jobs, verbose=5)(jobs)
    if given.json:
        with open(given.json, "w") as file:
            json.dump({"bound": bound, "rows": rows}, file, indent=1)
    report(bound, [r for r in rows if r is not None])


def report(bound: dict[str, float], rows: list[dict[str, Any]]) -> None:
    """Bound and rms error of every parameter, their ratio pooled, and the tilts."""
    print(f"\n{'parameter':<42}{'true':>11}{'bound':>9}{'rms':>9}{'rms/bound':>11}")
    ratios = {}
    for key, smallest in bound.items():
        rms = np.sqrt(np.mean([r["error"][key] ** 2 for r in rows]))
        ratios[key] = rms / smallest
        size = abs(TRUE.values[key])
        shares = f"{100 * smallest / size:>8.3g}%{100 * rms / size:>8.3g}%"
        print(f"{key:<42}{TRUE.values[key]:>11.4g}{shares}{ratios[key]:>11.2f}")
    pooled = np.sqrt(np.mean(np.square(list(ratios.values()))))
    print(f"pooled {pooled:.2f}, largest {max(ratios.values()):.2f}; "
          f"{sum(r['converged'] for r in rows)} of {len(rows)} converged, "
          f"median {np.median([r['seconds'] for r in rows]):.1f} s")  # fmt: skip
    print("not told by most: " + ", ".join(
        k for k in bound if np.mean([k in r["not_told"] for r in rows]) > 0.5))  # fmt: skip
    for name, words in (("all", "all calibrated"), ("factor", "common factor calibrated")):
        tilt = 100 * np.median([r["tilt"][name] for r in rows], axis=0)
        print(f"tilt error on a new record, {words}: alpha {tilt[0]:.3g} %, beta {tilt[1]:.3g} %")
    print(f"common factor: rms error {100 * np.std([r['factor'] for r in rows]):.3g} %")


if __name__ == "__main__":
    main()
