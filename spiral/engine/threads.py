"""One thread inside linear algebra: the windows are shared by threads already.

Small decompositions lose by threads of their own (measured: half the processor time saved), and
results then do not depend on how many threads a machine has.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import ParamSpec, TypeVar

THREADS = min(2, int(os.environ.get("NUMBA_NUM_THREADS", "2")))
"""Threads that share the windows or records of one step; no result depends on their number."""

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(step: Callable[P, R]) -> Callable[P, R]:
    """Run a step with BLAS and LAPACK limited to one thread."""

    @functools.wraps(step)
    def run_limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return step(*args, **kwargs)

    return run_limited
