"""Which bearing carries the nonlinear stiffness: judged by the likelihood of the innovations.

python -m experiments.hidden_states.which_bearing [--seeds 20] [--jobs 2] [--json FILE]

``strategy=innovation`` on the preset ``rotor_one_bearing``: a cubic spring in bearing 2 only,
linear part known, 2 % noise, five candidate effects at each bearing. Beside it the same machine
without any cubic spring, on which nothing must be admitted.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from spiral.inference.problem import silent
from spiral.inference.rounds import strategy_for
from spiral.io.config import build_problem, compose
from spiral.io.registry import load_registry

TRUE = "cubic_stiffness@bearing_2"
STIFFNESS = 1e11 / (0.75**4 + 0.25**4)  # N/m^3
NULL = "record.without=[cubic_stiffness@bearing_1,cubic_stiffness@bearing_2]"


def outcome(seed: int, null: bool) -> dict[str, Any]:
    """One round on one record: what is admitted, and what the likelihoods say."""
    clock = time.perf_counter()
    registry = load_registry(None)
    words = ["experiment=rotor_one_bearing", f"record.seed={seed}", f"test.seed={seed + 1000}"]
    config = compose([*words, *([NULL] if null else [])], registry)
    problem = build_problem(config, registry)
    strategy = strategy_for(problem)
    begun = strategy.begin(problem, silent)
    step = strategy.propose(begun.assembly, begun.fit_state, begun.comparison, 1, silent)
    found: dict[str, Any] = {
        "seed": seed,
        "null": null,
        "admitted": list(step.admitted),
        "aliases": list(step.aliases.get(TRUE, ())),
        "gains": dict(step.details["innovation"]["gain"]),
        "largest_score": max(step.details["innovation"]["score"].values()),
    }
    if step.admitted:
        settled = strategy.settle(begun.assembly, step, silent)
        key = f"{TRUE}.stiffness"
        found["estimate"] = settled.comparison.model.values.get(key)
        found["se"] = settled.comparison.model.errors.get(key)
    return {**found, "seconds": time.perf_counter() - clock}


def main() -> None:
    """Run both machines over the seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--json", help="file for the rows")
    given = parser.parse_args()
    jobs = [delayed(outcome)(s + 1, null) for null in (False, True) for s in range(given.seeds)]
    rows = [r for r in Parallel(n_jobs=given.jobs, verbose=5)(jobs) if r is not None]
    if given.json:
        with open(given.json, "w") as file:
            json.dump(rows, file, indent=1)
    report([r for r in rows if not r["null"]], [r for r in rows if r["null"]])


def report(spring: list[dict[str, Any]], null: list[dict[str, Any]]) -> None:
    """How often the right bearing is first, by how much, and the stiffness found."""
    right = [r for r in spring if r["admitted"] == [TRUE]]
    print(f"\nspring in bearing 2: admitted alone in {len(right)} of {len(spring)}, "
          f"with an alias in {sum(bool(r['aliases']) for r in right)}")  # fmt: skip
    lead = [
        v - max((g for k, g in r["gains"].items() if TRUE not in k), default=0.0)
        for r in right
        for v in [r["gains"][f"{TRUE}.stiffness"]]
    ]
    if right:
        off = np.array([r["estimate"] / STIFFNESS - 1 for r in right])
        share = np.mean([r["se"] for r in right]) / STIFFNESS
        print(f"2 log L above the next: {min(lead):.0f} to {max(lead):.0f}")
        print(f"stiffness off by {100 * np.sqrt(np.mean(off**2)):.3g} % rms, "
              f"standard error {100 * share:.3g} %")  # fmt: skip
    wrong = sum(bool(r["admitted"]) for r in null)
    print(f"no spring: something admitted in {wrong} of {len(null)}")
    print(f"median {np.median([r['seconds'] for r in (*spring, *null)]):.0f} s a record")


if __name__ == "__main__":
    main()
