"""Where the jobs of a sweep run: in this process, in processes of one machine, or on Dask.

The processes are joblib's (loky), one linear-algebra thread each; a Dask cluster is reached by its
scheduler's address. Both are driven as ``concurrent.futures`` executors, so that a process that
dies costs the job that killed it and no other.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from dataclasses import dataclass
from typing import Any, Literal

from spiral.types.errors import ConfigError, SpiralError

Job = tuple[str, ...]
Execute = Callable[[str, tuple[str, ...], Job, str | None], tuple[int, dict[str, Any]]]
"""(verb, names, overrides, plugin folder) -> (exit code, result)."""

Started = Callable[[int], object]

DEFECT = 1
_INNER = ("NUMBA", "OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR", "BLIS")
_IDLE = 60  # s after which a process without a job ends
_VARIABLES = ("SPIRAL_DATA", "SPIRAL_PLUGINS")
_AHEAD = 1  # jobs that wait in the pool, so that no process idles while an answer is worked on
_one_at_a_time = threading.Lock()  # of this process: Hydra and the compiler are not for threads


@dataclass(frozen=True)
class Backend:
    """``n_jobs`` at a time (-1: one for each processor, or all of a cluster), and where."""

    name: Literal["loky", "dask"] = "loky"
    address: str | None = None
    n_jobs: int = -1
    timeout: float = 10.0


@dataclass(frozen=True)
class JobCall:
    """A job as it is sent to a worker: verb, names, overrides, and the caller's surroundings."""

    verb: str
    names: tuple[str, ...]
    overrides: Job
    plugins: str | None
    folder: str
    variables: Mapping[str, str]


@dataclass(frozen=True)
class JobResult:
    """What came of a job: exit code, result, seconds."""

    exit: int
    result: dict[str, Any]
    seconds: float


class ClusterError(SpiralError):
    """The scheduler went away while jobs were under way."""


def make_call(verb: str, names: tuple[str, ...], overrides: Job, plugins: str | None) -> JobCall:
    """A job with the caller's folder and variables, so that paths mean the same to a worker."""
    variables = {k: os.environ[k] for k in _VARIABLES if k in os.environ}
    return JobCall(verb, names, overrides, plugins, os.getcwd(), variables)


def run_call(execute: Execute, call: JobCall) -> JobResult:
    """Carry out one job; a defect in it is its answer, not the end of the sweep."""
    clock = time.perf_counter()
    try:
        with _one_at_a_time, _caller_environment(call):
            clock = time.perf_counter()
            code, result = execute(call.verb, call.names, call.overrides, call.plugins)
    except (Exception, SystemExit) as error:
        code, result = DEFECT, error_result(f"{type(error).__name__}: {error}", "a run")
    return JobResult(code, result, time.perf_counter() - clock)


def error_result(given: str, expected: str, try_: str = "") -> dict[str, Any]:
    """A result that is only an error."""
    return {"error": {"given": given, "expected": expected, "try": try_}}


def run_calls(
    execute: Execute,
    calls: Mapping[int, JobCall],
    backend: Backend,
    started: Started = lambda _: None,
) -> Generator[tuple[int, JobResult], None, None]:
    """Every job's number and answer, in the order in which they end.

    Closing the iterator ends the processes that are under way. ``started`` is told each number.

    Raises
    ------
    ConfigError : Dask is not installed, or no scheduler with workers answers.
    ClusterError : the scheduler went away.
    """
    if backend.name == "dask":
        with _connect_client(backend) as client:
            yield from _run_with_workers(calls, _Dask(execute, started, client, backend))
    elif process_count(backend.n_jobs) == 1 or len(calls) == 1:
        for index, call in calls.items():
            started(index)
            yield index, run_call(execute, call)
    else:
        width = min(process_count(backend.n_jobs), len(calls))
        yield from _run_with_workers(calls, _Loky(execute, started, width))


def process_count(n_jobs: int) -> int:
    """``n_jobs`` as a number: -1 is one for each processor, -2 one less."""
    from joblib import cpu_count

    return n_jobs if n_jobs > 0 else max(1, cpu_count() + 1 + n_jobs)


def _run_with_workers(
    calls: Mapping[int, JobCall], workers: _Loky | _Dask
) -> Iterator[tuple[int, JobResult]]:
    """Run all jobs; those that were under way when a process died are suspects.

    Suspects run alone, after the others; one whose process dies again gets an error as its answer.
    """
    waiting, suspects = dict(calls), dict[int, JobCall]()
    while waiting:
        yield from workers.run(waiting, suspects, alone=False)
    for index, call in suspects.items():
        again: dict[int, JobCall] = {}
        yield from workers.run({index: call}, again, alone=True)
        if again:
            yield index, _killed_job_answer()


def _killed_job_answer() -> JobResult:
    given = "a job whose process was ended from outside (kill -9, or out of memory)"
    try_ = "fewer jobs at a time (n_jobs=1), a shorter record, or more memory"
    return JobResult(DEFECT, error_result(given, "a process that runs to its end", try_), 0.0)


@dataclass(frozen=True)
class _Loky:
    """Processes of this machine; where one dies, loky ends them all."""

    execute: Execute
    started: Started
    width: int

    def run(
        self, waiting: dict[int, JobCall], suspects: dict[int, JobCall], alone: bool
    ) -> Iterator[tuple[int, JobResult]]:
        """Take jobs from ``waiting`` until none is left or a process dies."""
        from joblib.externals.loky import get_reusable_executor

        room = 1 if alone else self.width + _AHEAD
        executor = get_reusable_executor(
            1 if alone else self.width,
            timeout=_IDLE,
            initializer=_initialise_worker,
            initargs=(os.getpid(),),
            env={f"{name}_NUM_THREADS": "1" for name in _INNER},
        )
        ended = _completed_futures(executor, self.execute, waiting, lambda: room, self.started)
        try:
            for index, call, future in ended:
                try:
                    yield index, future.result()
                except BrokenExecutor:
                    suspects[index] = call
        except BaseException:
            executor.shutdown(wait=True, kill_workers=True)
            raise


@dataclass(frozen=True)
class _Dask:
    """The workers of a cluster: as many jobs at a time as it has threads, which may change."""

    execute: Execute
    started: Started
    client: Any
    backend: Backend

    def run(
        self, waiting: dict[int, JobCall], suspects: dict[int, JobCall], alone: bool
    ) -> Iterator[tuple[int, JobResult]]:
        """Take all jobs from ``waiting``."""
        from distributed.scheduler import KilledWorker

        executor = self.client.get_executor(pure=False)
        width = (lambda: 1) if alone else self._worker_count
        ended = _completed_futures(executor, self.execute, waiting, width, self.started)
        try:
            for index, call, future in ended:
                try:
                    yield index, self._collect_answer(future)
                except KilledWorker:
                    suspects[index] = call
        finally:
            executor.shutdown(wait=False)

    def _worker_count(self) -> int:
        most = self.backend.n_jobs if self.backend.n_jobs > 0 else sys.maxsize
        try:
            return max(1, min(most, sum(self.client.ncores().values())))
        except OSError as error:
            raise self._lost_scheduler_error() from error

    def _collect_answer(self, future: Future[JobResult]) -> JobResult:
        from distributed.scheduler import KilledWorker

        try:
            return future.result()
        except KilledWorker:
            raise
        except CancelledError as error:
            raise self._lost_scheduler_error() from error
        except Exception as error:  # the job did not reach the worker, or its answer not us
            text = f"{type(error).__name__}: {error}"
            try_ = "the same versions of Python and of this program on every worker"
            return JobResult(DEFECT, error_result(text, "a worker that can run the job", try_), 0.0)

    def _lost_scheduler_error(self) -> ClusterError:
        return ClusterError(
            f"the Dask scheduler at {self.backend.address} went away",
            "a scheduler that stays until the sweep is done",
            "start it and the same sweep again: what is done is taken up",
        )


def _completed_futures(
    executor: Executor,
    execute: Execute,
    waiting: dict[int, JobCall],
    width: Callable[[], int],
    started: Started,
) -> Iterator[tuple[int, JobCall, Future[JobResult]]]:
    """Submit at most ``width()`` jobs at a time, and yield each future as it completes."""
    under_way: dict[Future[JobResult], tuple[int, JobCall]] = {}

    def fill() -> bool:
        room = (width() if waiting else 0) - len(under_way)
        for _ in range(min(room, len(waiting))):
            index = next(iter(waiting))
            try:
                future = executor.submit(run_call, execute, waiting[index])
            except BrokenExecutor:  # since the last look
                return False
            under_way[future] = index, waiting.pop(index)
            started(index)
        return True

    broken = not fill()
    while under_way:
        ended = wait(under_way, return_when=FIRST_COMPLETED).done
        broken = broken or any(_is_broken(future) for future in ended)
        completed = [(*under_way.pop(future), future) for future in ended]
        broken = broken or not fill()  # before anything is done with what has ended
        yield from completed


def _is_broken(future: Future[JobResult]) -> bool:
    return not future.cancelled() and isinstance(future.exception(), BrokenExecutor)


def _initialise_worker(parent: int) -> None:
    """A worker leaves Ctrl-C to its parent, and does not outlive it."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(DEFECT)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _connect_client(backend: Backend) -> Iterator[Any]:
    """A connection to the scheduler, which has workers."""
    try:
        from distributed import Client
    except ImportError as error:
        given = "sweep.backend=dask, and Dask is not installed"
        raise ConfigError(given, "the extra cluster", "pip install 'spiral-po[cluster]'") from error
    if not backend.address:
        raise ConfigError(
            "sweep.backend=dask without an address",
            "sweep.address=tcp://HOST:PORT of a Dask scheduler",
            "dask scheduler starts one and prints its address",
        )
    seconds = f"{backend.timeout:g} s"
    try:
        client = Client(backend.address, timeout=backend.timeout, set_as_default=False)
    except (OSError, ValueError) as error:  # a timeout is an OSError
        raise ConfigError(
            f"sweep.address={backend.address}: no scheduler answers within {seconds}",
            "the address that dask scheduler prints",
            "sweep.address=tcp://HOST:8786, or a longer sweep.timeout=SECONDS",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=backend.timeout)
        except OSError as error:
            raise ConfigError(
                f"sweep.address={backend.address}: a scheduler without workers for {seconds}",
                "at least one worker",
                f"dask worker {backend.address} --nworkers 2 --nthreads 1",
            ) from error
        yield client


@contextlib.contextmanager
def _caller_environment(call: JobCall) -> Iterator[None]:
    """Run the body in the caller's folder, with those of its variables that are not set here."""
    here = os.getcwd()
    added = {k: v for k, v in call.variables.items() if k not in os.environ}
    os.environ.update(added)
    if here != call.folder:
        os.chdir(call.folder)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
        if here != call.folder:
            os.chdir(here)
