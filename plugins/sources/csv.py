"""Records from CSV files."""

from __future__ import annotations

from spiral.io.readers.columns import Columns
from spiral.io.readers.formats import read_table
from spiral.io.readers.table import Table


class Csv(Columns):
    """Columns of one or several text files: a line of names, then rows of numbers.

    The way columns and fractions are written, lines above the names and a row of units under them
    are found. Parquet files are read as well.

    ``spiral.read`` uses the source ``file`` instead, which detects the format by content.
    """

    def read(self, path: str) -> Table:
        """The table of one file."""
        return read_table(path, self.separator, self.decimal, only_text=True)
