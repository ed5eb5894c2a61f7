"""Hide every effect in turn and see whether the study names it.

python experiments/hidden_effects/run.py [--only NAME ...] [--seeds 1] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

from joblib import Parallel, delayed

from experiments.hidden_effects.cases import CASES, Case, installed, problem
from spiral.inference.discover import discover
from spiral.io.problem_setup import USUAL_STRATEGY


def outcome(case: Case, seed: int, noise: float, strategy: str = USUAL_STRATEGY) -> dict[str, Any]:
    """One study: what was suggested first, and how the test error moved."""
    clock = time.perf_counter()
    run = discover(problem(case, installed(), seed, noise, strategy=strategy))
    last = run.rounds[-1]
    first = run.rounds[0].suggestions[0].effect if run.rounds[0].suggestions else None
    group = [*last.admitted, *last.aliases.get(first or "", ())]
    return {
        "hidden": case.effect,
        "seed": seed,
        "first": first,
        "aliases": list(last.aliases.get(first or "", ())),
        "hit": case.effect in group,
        "before": run.rounds[0].comparison.test_error / last.comparison.noise_floor,
        "after": last.comparison.test_error / last.comparison.noise_floor,
        "chi2_per_dof": last.comparison.chi2_per_dof,
        "seconds": time.perf_counter() - clock,
    }


def main() -> None:
    """Run the cases in parallel and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", help="effects to hide; all when left out")
    parser.add_argument("--seeds", type=int, default=1, help="records per effect")
    parser.add_argument("--noise", type=float, default=0.02, help="share of standard deviation")
    parser.add_argument("--json", help="file for the results")
    given = parser.parse_args()
    cases = [c for c in CASES if not given.only or c.effect in given.only]
    jobs = [(c, s + 1) for c in cases for s in range(given.seeds)]
    results = Parallel(n_jobs=-1, verbose=5)(delayed(outcome)(c, s, given.noise) for c, s in jobs)
    print(f"{'hidden':<26}{'first suggestion':<26}{'aliases':<24}{'before':>9}{'after':>8}")
    for row in results:
        mark = "" if row["hit"] else "  <- missed"
        print(
            f"{row['hidden']:<26}{row['first'] or '-':<26}{', '.join(row['aliases']):<24}"
            f"{row['before']:>9.2f}{row['after']:>8.3f}{mark}"
        )
    print("before, after: test error over the final model's noise floor")
    if given.json:
        with open(given.json, "w") as file:
            json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
