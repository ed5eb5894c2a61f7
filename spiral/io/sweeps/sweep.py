"""Sweeps: the same verb over many configurations, each job a row that is kept as it ends.

A sweep has a folder (``ledger``). Ended at any moment, by whatever, it loses the jobs that
were under way; the next start of the same sweep takes up the rows that are there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

from spiral.engine.signals import Interrupted, Signals
from spiral.inference.problem import Progress, silent
from spiral.io.sweeps.jobs import SweepPlan
from spiral.io.sweeps.ledger import Ledger, open_ledger
from spiral.io.sweeps.pool import (
    ClusterError,
    Execute,
    Job,
    JobResult,
    make_call,
    process_count,
    run_calls,
)
from spiral.types.errors import SpiralError

BAD_INPUT = 2
_AS_BEFORE = (0, 3)  # exit codes of a job that would come out the same


@dataclass(frozen=True)
class SweepRow:
    """One job of a sweep, as it ended; ``seconds`` of its own, in its process."""

    overrides: Job
    exit: int
    result: dict[str, Any]
    seconds: float = 0.0

    @property
    def run_id(self) -> str | None:
        """The saved run it made, for verbs that save one."""
        return self.result.get("run_id") or None

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "overrides": list(self.overrides),
            "exit": self.exit,
            "result": self.result,
            "seconds": self.seconds,
        }


OnRow = Callable[[str, int, SweepRow], None]
"""(sweep's id, job's number from zero, row): told once for each job as it ends, in this process.

Told again where a failed job is tried again, or where the process ended before the call came back;
what it writes should therefore be found by sweep and number, and replaced.
"""


@dataclass(frozen=True)
class Status:
    """How far a sweep is: jobs done, of them failed, s since the start, s to go (a guess)."""

    done: int
    total: int
    failed: int
    seconds: float
    remaining: float | None


@dataclass(frozen=True)
class Sweep:
    """A sweep as it ended: its rows in the sweep's order, those that are there.

    ``exit``: the largest of the rows', 130 or 143 where it was stopped, 2 where ``error`` says why
    it could not go on.
    """

    sweep_id: str
    folder: str
    jobs: tuple[Job, ...]
    rows: tuple[SweepRow, ...]
    taken_up: int
    seconds: float
    exit: int
    error: dict[str, str] | None = None

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        about = {
            "id": self.sweep_id,
            "folder": self.folder,
            "jobs": len(self.jobs),
            "done": len(self.rows),
            "taken_up": self.taken_up,
            "seconds": self.seconds,
        }
        content: dict[str, Any] = {"runs": [row.as_dict() for row in self.rows], "sweep": about}
        return {**content, "error": self.error} if self.error else content


def run_sweep(
    execute: Execute,
    plan: SweepPlan,
    tell: Progress = silent,
    on_status: Callable[[Status], None] | None = None,
    on_row: OnRow | None = None,
) -> Sweep:
    """Run every job that has no row yet; a failed job is a row, a stop keeps what is done.

    Raises
    ------
    InputError : the sweep's folder cannot be made.
    ConfigError : no Dask scheduler with workers answers.
    """
    asked = {"verb": plan.verb, "names": plan.names, "jobs": plan.jobs}
    ledger = open_ledger(plan.out, asked, plan.fingerprint, plan.options.resume)
    try:
        with Signals() as signals:
            desk = _RunningSweep(plan, ledger, signals, tell, on_status or (lambda _: None), on_row)
            return desk.run(execute)
    finally:
        ledger.close()


@dataclass
class _RunningSweep:
    """A running sweep in the parent process: its rows, jobs under way, ledger and callbacks."""

    plan: SweepPlan
    ledger: Ledger
    signals: Signals
    tell: Progress
    on_status: Callable[[Status], None]
    on_row: OnRow | None
    rows: dict[int, SweepRow] = field(default_factory=dict)
    under_way: set[int] = field(default_factory=set)
    taken_up: int = 0
    clock: float = field(default_factory=time.perf_counter)

    def run(self, execute: Execute) -> Sweep:
        """All jobs, and the sweep as it ended."""
        error, code = None, None
        try:
            self._load_earlier_rows()
            self._run_jobs(execute)
        except Interrupted as stop:
            code = stop.exit
            self.tell(self._stop_message())
        except (ClusterError, OSError) as lost:
            error, code = _error_fields(lost), BAD_INPUT
        except SpiralError as unwritten:
            if not self.rows:
                self.ledger.discard()
                raise
            error, code = unwritten.as_dict(), BAD_INPUT
        if code is None:
            code = max((row.exit for row in self.rows.values()), default=0)
        return self._finish_sweep(code, error)

    def _load_earlier_rows(self) -> None:
        """Rows of an earlier start; those that failed are tried again."""
        if not self.ledger.taken_up:
            return
        earlier = self.ledger.rows()
        kept = {i: r for i, r in earlier.items() if i < len(self.plan.jobs)}
        self.rows = {
            i: SweepRow(self.plan.jobs[i], r["exit"], r["result"], r.get("seconds", 0.0))
            for i, r in kept.items()
            if r["exit"] in _AS_BEFORE
        }
        self.taken_up = len(self.rows)
        again = len(kept) - self.taken_up
        more = f"; {again} that failed run again" if again else ""
        there = f"{self.taken_up} of {len(self.plan.jobs)} runs are there{more}"
        self.tell(f"taking up sweep {self.ledger.sweep_id}: {there}")
        for index, row in self.rows.items():
            if not self.ledger.has_hook_run(index):
                self._call_row_hook(index, row)

    def _run_jobs(self, execute: Execute) -> None:
        mine = f"sweep.id={self.ledger.sweep_id}"
        calls = {
            i: make_call(self.plan.verb, self.plan.names, (*job, mine), self.plan.plugins)
            for i, job in enumerate(self.plan.calls)
            if i not in self.rows
        }
        self._report_status()
        ended = run_calls(execute, calls, self.plan.backend, self.under_way.add)
        with closing(ended):
            for index, answer in ended:
                self._keep_row(index, answer)

    def _keep_row(self, index: int, answer: JobResult) -> None:
        """One job has ended: its row is written whole before anything else is done."""
        from spiral.io.writing import replace_nonfinite

        with self.signals.defer_signals():
            row = SweepRow(
                self.plan.jobs[index],
                answer.exit,
                replace_nonfinite(answer.result),
                round(answer.seconds, 3),
            )
            self.rows[index] = row
            self.under_way.discard(index)
            self.ledger.write_row(index, row.as_dict())
        self._report_status()
        self._call_row_hook(index, row)

    def _call_row_hook(self, index: int, row: SweepRow) -> None:
        """Call ``on_row`` for a row; an exception in it is reported, and the row is kept."""
        if self.on_row is None:
            return
        try:
            self.on_row(self.ledger.sweep_id, index, row)
        except Exception as error:
            self.tell(f"job {index + 1} is kept, but not told on: {type(error).__name__}: {error}")
        else:
            self.ledger.mark_hook_run(index)

    def _report_status(self) -> None:
        total, done = len(self.plan.jobs), len(self.rows)
        seconds = time.perf_counter() - self.clock
        new = done - self.taken_up
        remaining = seconds / new * (total - done) if new else None
        failed = sum(row.exit != 0 for row in self.rows.values())
        self.on_status(Status(done, total, failed, seconds, remaining))

    def _stop_message(self) -> str:
        kept = f"{len(self.rows)} of {len(self.plan.jobs)} runs are kept"
        lost = sorted(self.under_way - set(self.rows))
        if self.plan.backend.name == "loky":  # jobs begin in order; one may be waiting ready
            lost = lost[: process_count(self.plan.backend.n_jobs)]
        under_way = f", {len(lost)} under way are not" if lost else ""
        again = "; the same command takes it up" if len(self.rows) < len(self.plan.jobs) else ""
        return f"stopped: {kept}{under_way}{again}"

    def _finish_sweep(self, code: int, error: dict[str, str] | None) -> Sweep:
        sweep = Sweep(
            self.ledger.sweep_id,
            str(self.ledger.folder),
            self.plan.jobs,
            tuple(self.rows[i] for i in sorted(self.rows)),
            self.taken_up,
            round(time.perf_counter() - self.clock, 3),
            code,
            error,
        )
        if error is not None or len(self.rows) < len(self.plan.jobs):
            return sweep
        try:
            self.ledger.finish(sweep.as_dict())
        except SpiralError as unwritten:
            return replace(sweep, exit=BAD_INPUT, error=unwritten.as_dict())
        return sweep


def _error_fields(lost: Exception) -> dict[str, str]:
    if isinstance(lost, SpiralError):
        return lost.as_dict()
    return {"given": str(lost), "expected": "a sweep that can go on", "try": "the same command"}
