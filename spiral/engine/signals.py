"""Ctrl-C and SIGTERM as one exception that waits while something is being written."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


class Interrupted(BaseException):
    """A signal asked the process to stop; ``exit`` is 130 after Ctrl-C, 143 after SIGTERM."""

    def __init__(self, number: int) -> None:
        self.exit = 128 + number
        super().__init__(f"stopped by signal {number}")


class Signals:
    """Within it the first SIGINT or SIGTERM raises ``Interrupted``; a second acts as without it.

    Only the main thread can listen; elsewhere nothing changes.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._waiting: int | None = None
        self._held = False

    def __enter__(self) -> Signals:
        """Listen."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle_signal)
        return self

    def __exit__(self, *_: object) -> None:
        """Leave things as they were."""
        self._restore()

    @contextlib.contextmanager
    def defer_signals(self) -> Iterator[None]:
        """Defer a signal until the block has ended, then raise ``Interrupted``."""
        self._held = True
        try:
            yield
        finally:
            self._held = False
        self._raise()

    def _handle_signal(self, number: int, _: object) -> None:
        self._waiting = number
        self._restore()
        if not self._held:
            self._raise()

    def _raise(self) -> None:
        number, self._waiting = self._waiting, None
        if number is not None:
            raise Interrupted(number)

    def _restore(self) -> None:
        while self._before:
            number, before = self._before.popitem()
            signal.signal(number, before)
