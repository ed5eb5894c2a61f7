"""Records from files of any format that is known."""

from __future__ import annotations

from spiral.io.readers.columns import Columns
from spiral.io.readers.formats import read_table
from spiral.io.readers.table import Table


class File(Columns):
    """Columns of text, MAT, NPZ, Parquet, HDF5, UFF, TDMS or Excel files, told by their content.

    A column inside a container is named as in ``group/name``, ``struct.field``, ``cell[0]``; a
    matrix is a set of series along its longer side, the second one ``matrix[1]``.
    """

    def read(self, path: str) -> Table:
        """The table of one file."""
        return read_table(path, self.separator, self.decimal)
