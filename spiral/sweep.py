"""Sweeps: the same verb over many configurations, in processes of our own.

Workers are sent lists of overrides, never objects: a class loaded from a folder does not pickle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from spiral.problem import Progress

Job = tuple[str, ...]
Execute = Callable[[str, tuple[str, ...], Job, str | None], tuple[int, dict[str, Any]]]
"""(verb, names, overrides, plugin folder) -> (exit code, result)."""


@dataclass(frozen=True)
class Row:
    """One job of a sweep."""

    overrides: Job
    exit: int
    result: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """As the JSON contract writes it."""
        return {"overrides": list(self.overrides), "exit": self.exit, "result": self.result}


def run_sweep(
    execute: Execute,
    verb: str,
    names: tuple[str, ...],
    jobs: Sequence[Job],
    plugins: str | None,
    n_jobs: int,
    progress: Progress,
) -> tuple[Row, ...]:
    """Run every job; rows are in the sweep's order, a failed job is a row.

    An interruption keeps the rows that are done.
    """
    rows: dict[int, Row] = {}
    try:
        for index, row in _results(execute, verb, names, jobs, plugins, n_jobs):
            rows[index] = row
            progress(f"{len(rows)} of {len(jobs)} runs done")
    except KeyboardInterrupt:
        progress(f"stopped by you: {len(rows)} of {len(jobs)} runs are kept")
    return tuple(rows[i] for i in sorted(rows))


def _results(
    execute: Execute,
    verb: str,
    names: tuple[str, ...],
    jobs: Sequence[Job],
    plugins: str | None,
    n_jobs: int,
) -> Any:
    if n_jobs == 1 or len(jobs) == 1:
        for index, job in enumerate(jobs):
            yield _one(execute, index, verb, names, job, plugins)
        return
    from joblib import Parallel, delayed, parallel_config

    yield _one(execute, 0, verb, names, jobs[0], plugins)  # warms the cache of compiled models
    with parallel_config(backend="loky", inner_max_num_threads=1):
        pool = Parallel(n_jobs=n_jobs, return_as="generator_unordered")
        yield from pool(
            delayed(_one)(execute, index, verb, names, job, plugins)
            for index, job in enumerate(jobs)
            if index > 0
        )


def _one(
    execute: Execute,
    index: int,
    verb: str,
    names: tuple[str, ...],
    job: Job,
    plugins: str | None,
) -> tuple[int, Row]:
    try:
        code, result = execute(verb, names, job, plugins)
    except Exception as error:  # a defect in one job is its row, not the end of the sweep
        text = f"{type(error).__name__}: {error}"
        code, result = 1, {"error": {"given": text, "expected": "a run", "try": ""}}
    return index, Row(job, code, result)
