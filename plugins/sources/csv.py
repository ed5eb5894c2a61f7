"""Records from CSV files."""

from __future__ import annotations

from spiral.io.readers.columns import Columns
from spiral.io.readers.files import Table
from spiral.io.readers.readers import read_table


class Csv(Columns):
    """Columns of one or several text files: a line of names, then rows of numbers.

    The way columns and fractions are written, lines above the names and a row of units under them
    are found. Parquet files are read as well.
    """

    def read(self, path: str) -> Table:
        """The table of one file."""
        return read_table(path, self.separator, self.decimal, only_text=True)
