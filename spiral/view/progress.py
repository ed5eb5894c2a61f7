"""Progress for whoever watches: one line in a notebook or a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Literal

Tell = Callable[[str], None]


def progress_for(given: Tell | Literal[False] | None) -> AbstractContextManager[Tell]:
    """Context with the function for progress messages: ``given``, or one for this process.

    ``False`` drops them.
    """
    if given is False:
        return nullcontext(_ignore_message)
    if given is not None:
        return nullcontext(given)
    if "ipykernel" in sys.modules:
        return _notebook_line()
    if sys.stderr.isatty():
        from spiral.view.terminal.parts import progress_line

        return progress_line()
    return nullcontext(_ignore_message)


def _ignore_message(message: str) -> None:
    """Drop a progress message."""


@contextmanager
def _notebook_line() -> Iterator[Tell]:
    """One line below the cell that says what is being done, gone when it is done."""
    from IPython.display import display

    line = display({"text/plain": "starting"}, raw=True, display_id=True)
    if line is None:  # no cell to show it below
        yield _ignore_message
        return
    try:
        yield lambda message: line.update({"text/plain": message}, raw=True)
    finally:
        line.update({"text/plain": ""}, raw=True)
