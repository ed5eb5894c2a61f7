"""How long and how much memory reading a file may take: the same on the page and in a terminal."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from spiral.types.errors import InputError

_SECONDS, _SPEED = 30.0, 10**6  # for any file, and bytes in each second more
_MEMORY, _COPIES = 1_500_000_000, 12  # bytes for any file, and for each byte of it
_AGAIN = 1.0  # s after which a library that swallowed the first alarm is told once more


def time_limit(size: int) -> float:
    """How long reading a file of so many bytes may take, in s."""
    return _SECONDS + size / _SPEED


def memory_limit(size: int) -> int:
    """How many bytes of memory reading a file of so many bytes may take."""
    return _MEMORY + _COPIES * size


def time_limit_error(seconds: float) -> InputError:
    """The error for work on a file that exceeded its time limit."""
    return InputError(
        f"work on a file that had not ended after {seconds:.0f} s",
        "a file that is read in less",
        "keep the columns and rows you need; copy it here where it lies on a slow disk",
    )


@contextmanager
def within_seconds(seconds: float) -> Iterator[None]:
    """Limit the body of a ``with`` statement to so many seconds, by the system's alarm signal.

    A system without alarms, a thread other than the main one, and a program that has set an alarm
    of its own go without.

    Raises
    ------
    InputError : the work took longer.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or not hasattr(signal, "setitimer") or any(signal.getitimer(signal.ITIMER_REAL)):
        yield
        return

    def raise_time_limit(number: int, frame: object) -> NoReturn:
        raise time_limit_error(seconds)

    before = signal.signal(signal.SIGALRM, raise_time_limit)
    signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
