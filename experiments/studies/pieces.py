"""Studies in pieces: each in a process of its own with a time limit, a JSON line as it ends.

A line is kept under what tells studies apart (system, case, seed, strategy) and under the version
of the code and of the case that made it: the same command takes up what is there and does the rest.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

Row = dict[str, Any]
_THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA")
_PATIENCE = (
    4.0  # wall seconds for each processor second that a study may take: others work here too
)


@dataclass(frozen=True)
class Job:
    """One study: ``key`` tells it from others, ``made_of`` is the version of code and case.

    ``work`` is a function of a module with its arguments (``functools.partial``), run elsewhere.
    """

    key: Mapping[str, Any]
    made_of: Mapping[str, str]
    work: Callable[[], Row]

    @property
    def name(self) -> str:
        """Its name among the rows."""
        return _name(self.key, self.made_of)


def _name(key: Mapping[str, Any], made_of: Mapping[str, str]) -> str:
    return json.dumps([dict(key), dict(made_of)], sort_keys=True)


def version(*places: Path) -> str:
    """Twelve digits of the SHA-256 of all Python files at or under these places."""
    digest = hashlib.sha256()
    for place in places:
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.name.encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def engine() -> str:
    """The version of the package and of its plugins."""
    import spiral_plugins

    import spiral

    homes = [m.__file__ for m in (spiral, spiral_plugins)]
    return version(*(Path(h).parent for h in homes if h))


def kept(file: Path) -> list[Row]:
    """Rows that are there; a last line that was cut off is left out."""
    if not file.exists():
        return []
    found = []
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            print(f"{file}: a line that was cut off is left out", file=sys.stderr)
    return found


def of(rows: Sequence[Row], jobs: Sequence[Job]) -> list[Row]:
    """The rows of these jobs, in their order."""
    have = {_name(row["key"], row["made_of"]): row for row in rows}
    return [have[j.name] for j in jobs if j.name in have]


def finish(jobs: Sequence[Job], file: Path, limit: float, workers: int) -> list[Row]:
    """Rows of all jobs; those that are there are taken, the others computed and added.

    ``limit`` : processor seconds of a study, and a quarter of its wall seconds.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    have = {_name(row["key"], row["made_of"]) for row in kept(file)}
    left = [j for j in jobs if j.name not in have]
    print(f"{len(jobs)} studies, {len(jobs) - len(left)} there already", file=sys.stderr)
    for number, row in enumerate(_performed(left, limit, workers), 1):
        with file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(row, default=float) + "\n")
        told = " ".join(str(v) for v in row["key"].values())
        print(f"{number} of {len(left)}: {told}: {row['outcome']}", file=sys.stderr)
    return of(kept(file), jobs)


@dataclass(frozen=True)
class _Running:
    job: Job
    process: Any
    answer: Connection
    until: float


def _performed(jobs: Sequence[Job], limit: float, workers: int) -> Iterator[Row]:
    """Rows as they end; a study that takes too long, and only that, is ended."""
    for name in _THREADS:
        os.environ.setdefault(f"{name}_NUM_THREADS", "1")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["spiral.inference.discover", "spiral.api"])
    waiting, running = list(jobs), []
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(_started(context, waiting.pop(0), limit))
            soonest = min(r.until for r in running) - time.monotonic()
            ready = wait([r.answer for r in running], max(0.0, soonest))
            ended = [r for r in running if r.answer in ready or time.monotonic() > r.until]
            for one in ended:
                running.remove(one)
                yield _ended(one, limit)
    finally:
        for one in running:
            one.process.kill()


def _started(context: Any, job: Job, limit: float) -> _Running:
    answer, their_end = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job.work, their_end, limit), daemon=True)
    process.start()
    their_end.close()
    return _Running(job, process, answer, time.monotonic() + _PATIENCE * limit)


def _work(work: Callable[[], Row], answer: Connection, limit: float) -> None:
    """In the process of a study: its row, or how it failed, goes back."""
    _limited(limit)
    wall, clock = time.monotonic(), time.process_time()
    try:
        row = {"outcome": "done", **work()}
    except Exception as error:
        row = {"outcome": "failed", "error": f"{type(error).__name__}: {error}"}
    row.setdefault("seconds", time.process_time() - clock)
    answer.send({**row, "wall": time.monotonic() - wall})


def _limited(seconds: float) -> None:
    """The system ends this process after so many processor seconds; where it can (not Windows)."""
    with contextlib.suppress(ImportError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), most))


def _ended(one: _Running, limit: float) -> Row:
    if one.answer.poll():
        try:
            row = one.answer.recv()
        except EOFError:
            one.process.join(10)
            row = _died(one.process.exitcode, limit)
    else:
        one.process.kill()
        row = {"outcome": "timeout", "error": f"over {_PATIENCE * limit:g} s of wall time"}
    one.process.join(10)
    one.answer.close()
    job = one.job
    return {"job": job.name, "key": dict(job.key), "made_of": dict(job.made_of), **row}


def _died(code: int | None, limit: float) -> Row:
    if code == -signal.SIGXCPU:
        return {"outcome": "timeout", "error": f"over {limit:g} processor seconds"}
    return {"outcome": "failed", "error": f"died, exit code {code}"}
