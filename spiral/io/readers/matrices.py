"""Mass, damping and stiffness matrices from files, and the table of their nodes."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from spiral.io.readers.containers import Allowance, npz_arrays
from spiral.io.readers.limits import time_limit, within_seconds
from spiral.io.readers.matlab import mat_variables
from spiral.physics.structures.description import SENSORS, KeptNode, describe_structure
from spiral.types.errors import ConfigError, InputError, did_you_mean

NAMES = ("M", "K", "C", "G")
"""Mass, stiffness, damping, gyroscopic matrix per rad/s; ``K_NAME`` are parts of the stiffness."""
USES = (*SENSORS, "input", "port", "end")
"""What a node is used for; ``end`` of a pair, and nothing else."""
_COLUMNS = ("name", "dof", "use", "unit")
_ROWS = 10**7  # of a matrix; a sparse one may declare any number
_ENTRY, _FLOAT = 16, 8  # bytes of an entry of a sparse matrix, and of a full one


Nodes = str | Path | Mapping[str, Any] | Sequence[Mapping[str, Any]]
"""Nodes that are kept: a CSV file, its rows, or name -> fields."""


def read_structure(
    source: str | Path | Mapping[str, Any],
    nodes: Nodes,
    size: int,
    band: Sequence[float],
    pairs: Mapping[str, Any] | None,
    damping_ratio: float,
    highest: float | None = None,
) -> str:
    """The text of a reduced structure (``physics.structures.description``) from its files.

    Raises
    ------
    InputError, ConfigError : what cannot be read or used.
    """
    matrices = read_matrices(source)
    table = read_nodes(nodes, matrices["M"].shape[0])
    return describe_structure(matrices, table, size, band, pairs, damping_ratio, highest)


def read_matrices(source: str | Path | Mapping[str, Any]) -> dict[str, Any]:
    """Sparse matrices by name.

    Parameters
    ----------
    source : an NPZ or MAT file that holds them by name; or name -> array, sparse matrix, or a file
        with one matrix (Matrix Market ``.mtx``, Harwell-Boeing ``.hb .rb .rua .rsa``).

    Raises
    ------
    InputError : a file that cannot be read, no M or K, matrices that do not fit one another.
    """
    if isinstance(source, Mapping):
        given = {
            k: _read_single_matrix(v) if isinstance(v, str | Path) else v for k, v in source.items()
        }
    else:
        given = _read_matrix_file(Path(source).expanduser())
    matrices = {k: _sparse_columns(k, v) for k, v in given.items() if _is_matrix_name(k)}
    for name in ("M", "K"):
        if name not in matrices:
            raise InputError(
                f"matrices {', '.join(map(str, given)) or 'none'}",
                f"M and K, and where there are C, G and parts K_NAME; no {name} here",
                "numpy.savez('beam.npz', M=mass, K=stiffness)",
            )
    _check_matrices(matrices)
    return matrices


def _sparse_columns(name: str, matrix: Any) -> sparse.csc_matrix:
    """A matrix by columns, where it has no more rows and columns than can be worked with."""
    if max(np.shape(matrix), default=0) > _ROWS:
        raise InputError(f"{name} with {max(np.shape(matrix))} rows or columns", f"at most {_ROWS}")
    return sparse.csc_matrix(matrix)


def _is_matrix_name(name: str) -> bool:
    return name in NAMES or (name.startswith("K_") and name[2:].isidentifier())


def _read_matrix_file(path: Path) -> dict[str, Any]:
    try:
        with within_seconds(time_limit(path.stat().st_size)):
            return _arrays_by_name(path)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # the readers raise what their formats' parsers do
        raise InputError(f"{path}: {error}", "an NPZ or MAT file with matrices") from error


def _arrays_by_name(path: Path) -> dict[str, Any]:
    """The arrays of a file by name."""
    if path.suffix.lower() == ".npz":
        return npz_arrays(str(path), path)
    if path.suffix.lower() == ".mat":
        return mat_variables(str(path), path)
    raise InputError(
        f"{path}", "an NPZ or MAT file", "{'M': 'm.mtx', 'K': 'k.mtx'} for single ones"
    )


def _read_single_matrix(path: str | Path) -> Any:
    from scipy.io import hb_read, mminfo, mmread

    place = Path(path).expanduser()
    try:
        size = place.stat().st_size
        with within_seconds(time_limit(size)):
            if place.suffix.lower() != ".mtx":
                return hb_read(place)
            rows, columns, entries, form, *_ = mminfo(place)
            whole = rows * columns * _FLOAT
            Allowance(str(path), size).take(entries * _ENTRY if form == "coordinate" else whole)
            return mmread(place)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: {error}", "a Matrix Market or Harwell-Boeing file") from error


def _check_matrices(matrices: Mapping[str, Any]) -> None:
    size = matrices["M"].shape[0]
    for name, matrix in matrices.items():
        if matrix.shape != (size, size):
            raise InputError(
                f"{name} with {matrix.shape[0]} x {matrix.shape[1]} numbers",
                f"{size} x {size}, as M has",
            )
        if not np.isfinite(matrix.data).all():
            raise InputError(f"{name} with numbers that are not finite", "finite numbers")
        gap = matrix + matrix.T if name == "G" else matrix - matrix.T
        if abs(gap).max() > 1e-6 * abs(matrix).max():
            raise InputError(
                f"{name}, of which this does not hold",
                "G = -G^T" if name == "G" else f"{name} = {name}^T",
            )


def read_nodes(source: Nodes, size: int) -> tuple[KeptNode, ...]:
    """The nodes that are kept.

    Parameters
    ----------
    source : a CSV file with the columns ``name, dof, use`` and, where not all are in m, ``unit``;
        such rows, each a mapping; or name -> ``{"dof": 12, "use": "sensor port"}``. ``dof`` counts
        from zero.
    size : how many degrees of freedom there are.

    Raises
    ------
    InputError, ConfigError : a table that cannot be used.
    """
    if isinstance(source, Mapping):
        rows = _rows_of_mapping(source)
    elif isinstance(source, str | Path):
        rows = _read_node_table(Path(source).expanduser())
    else:
        rows = [dict(row) for row in source]
    nodes = tuple(_parse_node(row, size) for row in rows)
    for what in ("name", "dof"):
        values = [getattr(n, what) for n in nodes]
        twice = [v for v in values if values.count(v) > 1]
        if twice:
            raise ConfigError(f"nodes with {what} {twice[0]} twice", f"each {what} once")
    if not any(use in n.uses for n in nodes for use in SENSORS):
        expected = f"use {' or '.join(SENSORS)} at one of them at least"
        raise ConfigError("nodes without a sensor", expected)
    return nodes


def _rows_of_mapping(source: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [{"name": n, **(v if isinstance(v, Mapping) else {"dof": v})} for n, v in source.items()]


def _read_node_table(path: Path) -> list[dict[str, Any]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"table of nodes {str(path)!r}: {error}", "a CSV file") from error


def _parse_node(row: Mapping[str, Any], size: int) -> KeptNode:
    for key in row:
        if key not in _COLUMNS:
            raise ConfigError(
                f"column {key!r} of nodes", f"{', '.join(_COLUMNS)}",
                did_you_mean(str(key), _COLUMNS),
            )  # fmt: skip
    name, uses = str(row.get("name")), tuple(str(row.get("use") or "port").split())
    try:
        dof = int(str(row.get("dof")))
    except ValueError:
        dof = -1
    if not 0 <= dof < size:
        raise ConfigError(f"dof {row.get('dof')!r} of node {name}", f"a row from 0 to {size - 1}")
    for use in uses:
        if use not in USES:
            raise ConfigError(
                f"use {use!r} of node {name}", f"of {', '.join(USES)}", did_you_mean(use, USES)
            )
    return KeptNode(name, dof, uses, str(row.get("unit") or "m"))
