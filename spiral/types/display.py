"""Results that show themselves: as a short text anywhere, as a table in a notebook."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass

_MARKUP = re.compile(r"[|*_\\]")  # what Markdown takes for itself, in names and formulas


@dataclass(frozen=True)
class Summary:
    """A short account of a result: an opening sentence, one table, and advice."""

    opening: str
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    closing: str = ""

    def text(self) -> str:
        """In lines of plain text, the table's columns aligned."""
        table = [self.head, *self.rows] if self.rows else []
        width = {i: max(len(row[i]) for row in table) for i in self._nonempty_columns()}
        lines = ["  " + "  ".join(row[i].ljust(width[i]) for i in width) for row in table]
        return "\n".join(line.rstrip() for line in (self.opening, *lines, self.closing) if line)

    def markdown(self) -> str:
        """As a notebook shows it."""
        rows = [self.head, ("---",) * len(self.head), *self.rows] if self.rows else []
        cells = (
            [_MARKUP.sub(r"\\\g<0>", row[i]) for i in self._nonempty_columns()] for row in rows
        )
        table = "\n".join(f"| {' | '.join(row)} |" for row in cells)
        closing = self.closing.replace("\n", "  \n")  # a line's end is one there, too
        return "\n\n".join(part for part in (self.opening, table, closing) if part)

    def _nonempty_columns(self) -> list[int]:
        """Indices of the columns that are not empty in every row."""
        return [i for i in range(len(self.head)) if any(row[i] for row in self.rows)]


class Readable(ABC):
    """A result that prints a short text, and is a table in a notebook."""

    @abstractmethod
    def _shown(self) -> Summary:
        """Its summary."""

    def __repr__(self) -> str:
        return self._shown().text()

    def _repr_markdown_(self) -> str:
        return self._shown().markdown()
