"""One record, one library, many methods: PySINDy, delay coordinates, HAVOK, seed, shooting, paper.

python -m experiments.peers.run [--case rotor nothing silverbox] [--noise 0 0.02] [--seeds 3]
    [--methods NAME ...] [--duration 14] [--out runs/peers]

Rows are kept in the folder as they come and told to MLflow there; the same command takes up what is
left, and one with more seeds adds to it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from experiments.peers import tracked
from experiments.peers.cases import HIDDEN, Answer, Case, scored
from experiments.peers.delays import METHODS as DELAYS
from experiments.peers.delays import in_delays
from experiments.peers.regressions import METHODS, regressed
from spiral.commands.perform import perform_sweep_job
from spiral.inference.compare import compare
from spiral.inference.problem import Problem
from spiral.io.registry import load_registry

STRATEGIES = ("shooting", "paper")
ALL = ("seed only", *METHODS, *DELAYS, *STRATEGIES)


def answer(method: str, case: Case, problem: Problem, more: Sequence[str] = ()) -> Answer:
    """What one method makes of a case; ``more`` are overrides of the strategies."""
    if method in METHODS:
        return regressed(method, problem)
    if method in STRATEGIES:
        return _discovered(method, case, more)
    if method == "seed only":
        clock = time.perf_counter()
        found = compare(problem)
        return Answer(method, {}, found.test_error, time.perf_counter() - clock)
    return in_delays(method, problem)


def _discovered(strategy: str, case: Case, more: Sequence[str]) -> Answer:
    clock = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        given = (*case.overrides, f"strategy={strategy}", f"out={folder}", *more)
        _, result = perform_sweep_job("discover", (), given, None)
    seconds = time.perf_counter() - clock
    if "model" not in result:
        raise RuntimeError(f"strategy={strategy}: {result.get('error')}")
    effects = result["model"]["effects"]
    values = {
        f"{effect}.{name}": found["estimate"]
        for effect, parameters in effects.items()
        for name, found in parameters.items()
    }
    return Answer(strategy, values, _last_error(result), seconds)


def _last_error(result: dict[str, Any]) -> float:
    error = result["rounds"][-1]["test_error"]
    return float("inf") if error is None else float(error)


def row(method: str, case: Case, more: Sequence[str] = ()) -> dict[str, Any]:
    """One row of the table."""
    problem = case.problem(load_registry(None))
    found = scored(case, answer(method, case, problem, more), case.truth())
    return {**found, "duration": case.duration}


def line(found: dict[str, Any]) -> str:
    """A row as it is printed."""
    start = f"{found['case']:<10}{found['noise']:>6g}{found['seed']:>6}  {found['method']:<18}"
    hidden = [h for h in HIDDEN if h in found["found"]]
    if not found["named"]:
        middle = f"{'names no terms':<58}"
    elif "false" in found:
        errors = " ".join(f"{found['errors'].get(k, np.nan):>9.1%}" for k in _keys(found))
        middle = f"{len(hidden)} of {len(HIDDEN)}  {len(found['false']):>3} false  {errors:<36}"
    else:
        middle = f"{len(found['found']):>3} terms, {', '.join(hidden):<46}"
    return f"{start}{middle:<60}{found['test_error']:>10.2%}{found['seconds']:>8.1f} s"


def _keys(found: dict[str, Any]) -> list[str]:
    return sorted(found["errors"])


def main() -> None:
    """Run the methods in parallel, one process each, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", nargs="*", default=["rotor"], help="rotor, nothing, silverbox")
    parser.add_argument("--noise", nargs="*", type=float, default=[0.02])
    parser.add_argument("--seeds", type=int, default=1, help="records per case and noise")
    parser.add_argument("--methods", nargs="*", default=list(ALL))
    parser.add_argument("--duration", type=float, default=14.0, help="of simulated records, s")
    parser.add_argument("--out", type=Path, default=Path("runs/peers"), help="folder of the rows")
    parser.add_argument("--jobs", type=int, default=-1, help="processes")
    given = parser.parse_args()
    cases = [
        Case(name, noise, 11 + seed, given.duration)
        for name in given.case
        for noise in (given.noise if name != "silverbox" else [0.0])
        for seed in range(given.seeds if name != "silverbox" else 1)
    ]
    rows = collected(cases, given.methods, given.out, given.jobs)
    print(f"\n{tracked.table(rows)}")


def collected(
    cases: Sequence[Case], methods: Sequence[str], out: Path, jobs: int
) -> list[dict[str, Any]]:
    """All rows of a folder, those that were missing among them; MLflow is told of each."""
    rows = tracked.kept(out)
    known = {tracked.name_of(r) for r in rows}
    wanted = [
        (method, case)
        for case in cases
        for method in methods
        if tracked.name_of({**vars(case), "case": case.name, "method": method}) not in known
    ]
    todo = [delayed(row)(method, case) for method, case in wanted]
    for found in Parallel(n_jobs=jobs, return_as="generator")(todo):
        rows.append(found)
        print(line(found), flush=True)
        tracked.keep(out, rows)
        tracked.tell(out, rows[-1:])
    tracked.tell(out, rows)
    return rows


if __name__ == "__main__":
    main()
