"""Blocks of a regression's rows, over which robust tests take sums.

Of rows [J | r] they ask for J_g^T (J_o w) within each block: a few columns against a combination
of a few others. The Gram matrices of all columns hold these and, of hundreds of candidates,
thousands of times more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from spiral.types.record import Array


class Blocks(Protocol):
    """Rows [J | r] in blocks."""

    def __len__(self) -> int: ...

    def products(self, group: Sequence[int], others: Sequence[int], weights: Array) -> Array:
        """(blocks, group) of J_g^T (J_o w) in each block; -1 among the columns is r."""
        ...


@dataclass(frozen=True)
class GramBlocks:
    """Blocks of which only the Gram matrices are known: (blocks, columns + 1, columns + 1)."""

    grams: Array

    def __len__(self) -> int:
        return len(self.grams)

    def products(self, group: Sequence[int], others: Sequence[int], weights: Array) -> Array:
        """As in ``Blocks``."""
        return self.grams[:, group][:, :, others] @ weights


@dataclass(frozen=True)
class RowBlocks:
    """The rows themselves, each column one after the other in memory.

    ``columns`` (columns + 1, rows) is [J | r]^T; ``first`` the first row of each block.
    """

    columns: Array
    first: Array

    def __len__(self) -> int:
        return len(self.first)

    def products(self, group: Sequence[int], others: Sequence[int], weights: Array) -> Array:
        """As in ``Blocks``."""
        if not len(self.first):
            return np.zeros((0, len(group)))
        combined = weights @ self.columns[others]
        return np.add.reduceat(self.columns[group] * combined, self.first, axis=1).T


NO_BLOCKS = GramBlocks(np.zeros((0, 0, 0)))
