"""Worker processes beside the page: one fits, one writes runs down. Spawned, never forked.

An order goes in as plain data, events come back as plain data; cancelling ends the process, so that
no fit can hold the page up, and the next one finds its study on disk. An order may have a limit of
``seconds``, counted from its first event, and of ``memory``, in bytes beyond what the process has.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from spiral.io.readers.limits import time_limit_error
from spiral.types.errors import InputError, SpiralError

Event = Mapping[str, Any]
OnEvent = Callable[[Mapping[str, Any], str, Event], None]
"""Told of an order, the kind of event, and its data; the last kind is ``done``."""

_ENDED = {
    "given": "a process that ended in the middle of its work",
    "expected": "a process that runs to its end",
    "try": "the same again; if it happens again, a shorter record or more memory",
}


class Process:
    """One process and its queue of orders, handled one after the other."""

    def __init__(self, kind: str, out: Path, on_event: OnEvent) -> None:
        self._kind, self._out, self._on_event = kind, out, on_event
        self._lock = threading.Lock()
        self._orders: list[Mapping[str, Any]] = []
        self._under_way: Mapping[str, Any] | None = None
        self._wake = threading.Event()
        self._closed = self._cancelled = False
        self._process: Any = None
        self._pipe: Connection | None = None
        self._spawn_process()
        threading.Thread(target=self._run_queue, daemon=True).start()

    def give(self, order: Mapping[str, Any]) -> None:
        """Queue an order."""
        with self._lock:
            self._orders.append(order)
        self._wake.set()

    def cancel(self, study: str) -> bool:
        """End what is under way for a study, and forget what waits; whether there was anything."""
        with self._lock:
            waiting = [o for o in self._orders if o["study"] == study]
            self._orders = [o for o in self._orders if o["study"] != study]
            current = self._under_way is not None and self._under_way["study"] == study
            if current:
                self._cancelled = True
                self._process.kill()
        for order in waiting:
            self._on_event(order, "cancelled", {})
        return current or bool(waiting)

    def close(self) -> None:
        """End the process, whatever it does."""
        self._closed = True
        self._wake.set()
        self._process.kill()

    def _spawn_process(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=run_worker_loop,
            args=(self._kind, str(self._out), theirs, os.getpid()),
            daemon=True,
        )
        self._process.start()
        theirs.close()

    def _run_queue(self) -> None:
        while not self._closed:
            self._wake.wait()
            with self._lock:
                self._under_way = self._orders.pop(0) if self._orders else None
                if self._under_way is None:
                    self._wake.clear()
                    continue
                if self._cancelled:  # too late for the order before: its process has ended
                    self._process.join(5)
                    self._cancelled = False
                if not self._process.is_alive():
                    self._spawn_process()
            self._run_order(self._under_way)
            with self._lock:
                self._under_way = None

    def _run_order(self, order: Mapping[str, Any]) -> None:
        """Send one order and pass its events on, until it is done or its process is gone."""
        assert self._pipe is not None
        ends = None
        late = False
        try:
            self._pipe.send(dict(order))
            while True:
                late = not self._pipe.poll(None if ends is None else max(ends - _now(), 0.0))
                if late:
                    self._process.kill()
                kind, data = self._pipe.recv()
                if ends is None and "seconds" in order:
                    ends = _now() + order["seconds"]
                self._on_event(order, kind, data)
                if kind in ("done", "failed"):
                    return
        except (EOFError, OSError):
            self._process.join(5)
            if self._closed:
                return
            with self._lock:
                cancelled, self._cancelled = self._cancelled, False
                self._spawn_process()
            ended = time_limit_error(order["seconds"]).as_dict() if late else _ENDED
            self._on_event(order, *(("cancelled", {}) if cancelled else ("failed", ended)))


_now = time.monotonic


@contextmanager
def _memory_limit(memory: int | None) -> Iterator[None]:
    """At most so many bytes more than the process has now, where the system can say so.

    Raises
    ------
    InputError : the work needed more.
    """
    statm = Path("/proc/self/statm")  # of Linux
    if memory is None or not statm.is_file():
        yield
        return
    import resource

    pages = int(statm.read_text(encoding="ascii").split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    wanted = pages * resource.getpagesize() + memory
    usual = before[0] if before[0] != resource.RLIM_INFINITY else wanted
    resource.setrlimit(resource.RLIMIT_AS, (min(wanted, usual), before[1]))
    try:
        yield
    except MemoryError as error:
        raise InputError(
            f"a file that takes more than {memory / 1e9:.2g} GB of memory to read",
            "one that takes less", "keep the columns and rows you need",
        ) from error  # fmt: skip
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def run_worker_loop(kind: str, out: str, pipe: Connection, parent: int) -> None:
    """The process: take orders until the pipe closes."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _exit_with_parent(parent)

    def send_event(what: str, data: Event) -> None:
        pipe.send((what, dict(data)))

    worker = _make_worker(kind, Path(out), send_event)
    while True:
        try:
            order = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            with _memory_limit(order.get("memory")):
                getattr(worker, order["do"])(order)
        except SpiralError as error:
            send_event("failed", _hide_upload_folder(out, error.as_dict()))
        except Exception as error:  # a defect costs one order, and says so
            send_event("failed", _defect_message(error))
        else:
            send_event("done", {})
        _release_memory()


def _release_memory() -> None:
    """Return to the system what the order needed and nothing holds any more (glibc keeps it)."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(ctypes.c_size_t(0))


def _make_worker(kind: str, out: Path, tell: Any) -> Any:
    """The object whose methods carry out orders, with all that it needs imported."""
    from spiral.io.registry import load_registry

    load_registry(local=False)  # local plugins are run when an order asks for them
    if kind == "writer":
        os.nice(10)  # the page waits for the other one
        from spiral.app.run_writer import RunWriter

        return RunWriter(out, tell)
    import spiral.engine.filter.kernel
    import spiral.engine.kernel  # noqa: F401  (compiled, or read from the cache, before a click)
    from spiral.app.fit_worker import FitWorker

    return FitWorker(out, tell)


def _hide_upload_folder(out: str, error: Mapping[str, str]) -> dict[str, str]:
    """The message with the names of uploaded files as the user knows them."""
    folder = re.compile(re.escape(out) + r"/studies/uploads/[0-9a-f-]+/")
    return {k: folder.sub("", v) for k, v in error.items()}


def _defect_message(error: Exception) -> dict[str, str]:
    import logging

    logging.getLogger("spiral.app").exception("an order failed")
    return {
        "given": f"{type(error).__name__}: {error}"[:400],
        "expected": "a step that runs to its end",
        "try": "another effect, or the same study on the command line: spiral diagnose",
    }


def _exit_with_parent(parent: int) -> None:
    """End this process when the page's process, its parent, has ended."""

    def exit_when_orphaned() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(0)

    threading.Thread(target=exit_when_orphaned, daemon=True).start()
