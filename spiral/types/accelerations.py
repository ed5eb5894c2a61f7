"""Accelerations of a machine from its forces."""

from __future__ import annotations

from typing import Any


def solve_accelerations(mass: list[list[Any]], total: list[Any]) -> list[Any]:
    """M^-1 total: by division where M is diagonal (units kept), else symbolically."""
    size = len(total)
    off = [mass[i][j] for i in range(size) for j in range(size) if i != j]
    if all(isinstance(value, int | float) and value == 0 for value in off):
        return [t / mass[i][i] for i, t in enumerate(total)]
    if all(isinstance(value, int | float) for row in mass for value in row):
        import numpy

        return [sum(float(m) * t for m, t in zip(row, total, strict=True))
                for row in numpy.linalg.inv(mass)]  # fmt: skip
    import sympy

    return list(sympy.Matrix(mass).LUsolve(sympy.Matrix(total)))
