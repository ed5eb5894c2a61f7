"""Reconstruct the hidden tilts under every condition, beside the static map and the paper.

python -m experiments.hidden_states.run [--only GROUP ...] [--seeds 20] [--jobs 2] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from experiments.hidden_states.cases import CASES, Case, observer, task
from spiral.inference.reconstruction.estimate import combine_reconstructions, reconstruct_record

STATES = ("alpha", "beta")


def outcome(case: Case, seed: int) -> list[dict[str, Any]]:
    """One record through every observer of a case; the tuned levels are found once."""
    given = task(case, seed)
    rows, levels = [], None
    for name in case.observers:
        clock = time.perf_counter()
        chosen = observer(case, name)
        if levels is not None:
            chosen = replace(chosen, process_noise=levels)
        part = reconstruct_record(given, chosen)
        levels = part.reconstruction.levels or None
        rows.append(_row(case, seed, name, part, time.perf_counter() - clock))
    return rows


def _row(case: Case, seed: int, name: str, part: Any, seconds: float) -> dict[str, Any]:
    scored = combine_reconstructions(name, [part])
    states = {k: v.as_dict() for k, v in scored.states.items()}
    seen = part.consistency
    return {
        "case": case.name,
        "observer": name,
        "seed": seed,
        "diverged": part.diverged,
        "static": dict(scored.baseline),
        "nis": scored.nis_mean,
        "nis_bands_outside": sum(not b.nis.inside for b in seen.bands) if seen else None,
        "whiteness_p": seen.whiteness_p if seen else None,
        "prediction": dict(seen.prediction) if seen else None,
        "levels": dict(part.reconstruction.levels),
        "seconds": seconds,
        **{k: {s: states[s][k] for s in states} for k in
           ("relative", "correlation", "coverage_95", "reached_2_percent_s")},
    }  # fmt: skip


def main() -> None:
    """Run all records in parallel and print one table for each group."""
    parser = argparse.ArgumentParser(description=__doc__)
    groups = list(dict.fromkeys(c.group for c in CASES))
    parser.add_argument("--only", nargs="*", choices=groups, help="groups; all when left out")
    parser.add_argument("--seeds", type=int, default=20, help="records of each case")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--json", help="file for the rows")
    given = parser.parse_args()
    cases = [c for c in CASES if not given.only or c.group in given.only]
    clock = time.perf_counter()
    jobs = [delayed(outcome)(c, s + 1) for c in cases for s in range(given.seeds)]
    rows = [row for found in Parallel(n_jobs=given.jobs, verbose=1)(jobs) for row in found]
    for group in dict.fromkeys(c.group for c in cases):
        print_table([c for c in cases if c.group == group], rows)
    print(
        f"\n{len(jobs)} records in {time.perf_counter() - clock:.0f} s with {given.jobs} processes"
    )
    if given.json:
        with open(given.json, "w") as file:
            json.dump(rows, file, indent=1)


def print_table(cases: list[Case], rows: list[dict[str, Any]]) -> None:
    """Median over seeds with the middle 80 %; errors of alpha / beta in %."""
    print(f"\n{'':<28}{'observer':<11}{'alpha':>28}{'beta':>28}{'x':>7}{'static':>14}{'paper':>13}"
          f"{'in 95 %':>9}{'NIS':>7}{'2 % after':>10}")  # fmt: skip
    for case in cases:
        for name in case.observers:
            mine = [r for r in rows if r["case"] == case.name and r["observer"] == name]
            print(f"{case.name:<28}{name:<11}{_line(case, mine)}")


def _line(case: Case, mine: list[dict[str, Any]]) -> str:
    def over(key: str, state: str) -> np.ndarray:
        return np.array([r[key][state] for r in mine], dtype=float)

    cells = [_spread(100 * over("relative", s)) for s in STATES]
    covered = np.mean([over("coverage_95", s) for s in STATES])
    times = np.concatenate([over("reached_2_percent_s", s) for s in STATES])
    reached = np.median(np.where(np.isfinite(times), times, np.inf))
    static = "/".join(f"{100 * np.median(over('static', s)):.2f}" for s in STATES)
    paper = "/".join(f"{100 * v:.1f}" for v in case.paper) if case.paper else "-"
    lost = sum(r["diverged"] for r in mine)
    return (
        f"{cells[0]:>28}{cells[1]:>28}{100 * np.median(over('relative', 'x')):>7.2f}{static:>14}"
        f"{paper:>13}{100 * covered:>9.1f}{np.median([r['nis'] for r in mine]):>7.3f}"
        f"{(f'{reached:.2f} s' if np.isfinite(reached) else '-'):>10}"
        + (f"  {lost} lost" if lost else "")
    )


def _spread(values: np.ndarray) -> str:
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return f"{middle:.3g} [{low:.3g}, {high:.3g}]"


if __name__ == "__main__":
    main()
