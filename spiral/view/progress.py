"""Progress for whoever watches: one line in a notebook or a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

Tell = Callable[[str], None]


def progress_for(given: Tell | None) -> AbstractContextManager[Tell]:
    """What a step tells its progress to: the function ``given``, or what this process has."""
    if given is not None:
        return nullcontext(given)
    if "ipykernel" in sys.modules:
        return _line_in_a_notebook()
    if sys.stderr.isatty():
        from spiral.view.terminal.parts import progress

        return progress()
    return nullcontext(_silent)


def _silent(message: str) -> None:
    """Nobody watches."""


@contextmanager
def _line_in_a_notebook() -> Iterator[Tell]:
    """One line below the cell that says what is being done, gone when it is done."""
    from IPython.display import display

    line = display({"text/plain": "starting"}, raw=True, display_id=True)
    if line is None:  # no cell to show it below
        yield _silent
        return
    try:
        yield lambda message: line.update({"text/plain": message}, raw=True)
    finally:
        line.update({"text/plain": ""}, raw=True)
