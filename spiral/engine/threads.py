"""Threads that share independent work, and one thread inside linear algebra.

Windows, records and fits of candidates are shared by threads; small decompositions lose by threads
of their own (measured: half the processor time saved). No result depends on how many threads a
machine has.
"""

from __future__ import annotations

import contextvars
import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from numba.core import config

THREADS: int = config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
"""Threads that share the windows, records or fits of one step: cores that this process may use."""
_AT_ONCE = 2_000_000  # samples that threads beyond the second may hold in passes at once
_inside = contextvars.ContextVar("inside", default=False)

P = ParamSpec("P")
R = TypeVar("R")
Job = TypeVar("Job")


def run_in_threads(run: Callable[[Job], R], jobs: Sequence[Job], samples: int = 0) -> list[R]:
    """Results of a function of every job, in their order, on up to ``THREADS`` threads.

    Work that is itself one of such jobs is done in its own thread. What a context variable says
    (how NumPy treats an overflow) holds in the threads too. ``samples`` is the size of a job, which
    limits how many run at once: memory grows with them.
    """
    most = min(THREADS, max(2, _AT_ONCE // max(samples, 1)), len(jobs))
    if most < 2 or _inside.get():
        return [run(job) for job in jobs]

    def run_inside(job: Job) -> R:
        _inside.set(True)
        return run(job)

    contexts = [contextvars.copy_context() for _ in jobs]
    with ThreadPoolExecutor(most) as pool:
        started = [
            pool.submit(c.run, run_inside, job) for c, job in zip(contexts, jobs, strict=True)
        ]
        try:
            return [one.result() for one in started]
        finally:
            for one in started:
                one.cancel()


def one_blas_thread(step: Callable[P, R]) -> Callable[P, R]:
    """Run a step with BLAS and LAPACK limited to one thread."""

    @functools.wraps(step)
    def run_limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return step(*args, **kwargs)

    return run_limited
