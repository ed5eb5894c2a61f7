"""Calibration errors over 1, 4 and 16 records of one machine, which should fall as 1 / sqrt n.

python -m experiments.hidden_states.several_records [--seeds 20] [--records 1 4 16] [--duration 7]

The machine's bearings differ (each parameter of bearing 1 up by a fifth, of bearing 2 down): with
equal bearings single ones are told worst, and the bound changes within one standard error.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from spiral_plugins.sources.simulation import Simulation

from experiments.hidden_states.calibration import BEARINGS, SYSTEM, TRUE
from spiral.inference.problem import Problem
from spiral.inference.reconstruction.calibrate import calibrate, cramer_rao
from spiral.types.model import Model
from spiral.types.record import Record

UNEQUAL = 0.2
OFF = 0.1  # share by which every bearing parameter starts wrong, with a sign of its own
MACHINE = replace(
    TRUE,
    values={
        **TRUE.values,
        **{k: TRUE.values[k] * (1 + UNEQUAL if "@bearing_1" in k else 1 - UNEQUAL)
           for k in BEARINGS},
    },
)  # fmt: skip


def records(first: int, count: int, duration: float) -> tuple[Record, ...]:
    """Run-downs of the machine through all speeds in ``duration`` s, the noise of each its own."""
    made = Simulation(
        values=dict(MACHINE.values),
        inputs={"speed": {"sweep": [40, 0], "unit": "Hz"}},
        duration=duration,
    )
    return tuple(replace(made, seed=first + i).load(SYSTEM)[0] for i in range(count))


def outcome(seed: int, count: int, duration: float) -> dict[str, Any]:
    """One calibration of every parameter."""
    clock = time.perf_counter()
    signs = np.random.default_rng([seed, 7]).choice((-1.0, 1.0), len(BEARINGS))
    wrong = {k: MACHINE.values[k] * (1 + OFF * s) for k, s in zip(BEARINGS, signs, strict=True)}
    start: Model = replace(MACHINE, values={**MACHINE.values, **wrong})
    found = calibrate(Problem(start, records(1000 * seed, count, duration), ()))
    return {
        "seed": seed,
        "records": count,
        "converged": found.converged,
        "seconds": time.perf_counter() - clock,
        "error": {k: found.model.values[k] - MACHINE.values[k] for k in found.model.errors},
        "se": dict(found.model.errors),
    }


def main() -> None:
    """Run the seeds in parallel, many records first, and print errors over those of one record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--records", type=int, nargs="+", default=[1, 4, 16])
    parser.add_argument("--duration", type=float, default=7.0, help="s of each record")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--json", help="file for the rows")
    given = parser.parse_args()
    bounds = {
        n: cramer_rao(Problem(MACHINE, records(0, n, given.duration), ())) for n in given.records
    }
    order = sorted(given.records, reverse=True)
    jobs = [delayed(outcome)(s + 1, n, given.duration) for n in order for s in range(given.seeds)]
    rows = [r for r in Parallel(n_jobs=given.jobs, verbose=5)(jobs) if r is not None]
    if given.json:
        with open(given.json, "w") as file:
            json.dump({"bounds": bounds, "rows": rows}, file, indent=1)
    report(bounds, rows)


def report(bounds: dict[int, dict[str, float]], rows: list[dict[str, Any]]) -> None:
    """Pooled error over the bound of its own records and over that of one; the slope on log n."""
    counts = sorted(bounds)
    first = bounds[counts[0]]
    sizes = []
    print(f"\n{'records':>8}{'rms / own bound':>17}{'largest':>9}{'rms / bound of one':>20}"
          f"{'bound':>8}{'converged':>11}{'median s':>10}")  # fmt: skip
    for n in counts:
        mine = [r for r in rows if r["records"] == n]
        rms = {k: np.sqrt(np.mean([r["error"][k] ** 2 for r in mine])) for k in first}
        own = np.array([rms[k] / bounds[n][k] for k in first])
        one = np.sqrt(np.mean([(rms[k] / first[k]) ** 2 for k in first]))
        least = np.sqrt(np.mean([(bounds[n][k] / first[k]) ** 2 for k in first]))
        sizes.append(one)
        print(f"{n:>8}{np.sqrt(np.mean(own**2)):>17.2f}{own.max():>9.2f}{one:>20.3f}{least:>8.3f}"
              f"{sum(r['converged'] for r in mine):>8} / {len(mine)}"
              f"{np.median([r['seconds'] for r in mine]):>9.0f}")  # fmt: skip
    if len(counts) > 1:
        slope = np.polyfit(np.log(counts), np.log(sizes), 1)[0]
        print(f"error ~ n^{slope:.2f} (n^-0.5 where records add up)")


if __name__ == "__main__":
    main()
