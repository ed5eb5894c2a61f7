"""Matrices of a reduced structure, as text for saved runs and other processes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.record import Array

SENSORS = ("sensor", "accelerometer")
"""What of a node is measured: its displacement, or its acceleration."""
_ROUNDING = 1e-10  # of the largest entry of a matrix


@dataclass(frozen=True)
class KeptNode:
    """A degree of freedom that is kept: its row in the matrices, its unit, what it is used for."""

    name: str
    dof: int
    uses: tuple[str, ...]
    unit: str = "m"


@dataclass(frozen=True)
class StructureForm:
    """Matrices of the coordinates, which are nodes first, then modes.

    ``damping`` is C, or with ``by_ratio`` the matrix whose multiple by a ratio z gives every mode
    of the reduced structure the damping z: 2 M V diag(w) V^T M with V^T M V = I. ``band``, Hz, is
    where the reduced structure answers as the full one does.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    uses: tuple[tuple[str, ...], ...]
    pairs: tuple[tuple[str, str, str], ...]
    mass: Array
    stiffness: Array
    parts: dict[str, Array]
    damping: Array
    by_ratio: bool
    ratio: float
    gyroscopic: Array | None
    band: tuple[float, float]
    report: str

    @cached_property
    def compliance(self) -> Array:
        """M^-1."""
        return np.linalg.inv(self.mass)

    def divide_by_mass(self, matrix: Array) -> Array:
        """M^-1 times a matrix; what is zero but for rounding is zero."""
        solution = np.linalg.solve(self.mass, matrix)
        return np.where(np.abs(solution) > _ROUNDING * np.abs(solution).max(), solution, 0.0)


def describe_structure(
    matrices: Mapping[str, Any],
    table: Sequence[KeptNode],
    size: int,
    band: Sequence[float],
    pairs: Mapping[str, Any] | None,
    damping_ratio: float,
    highest: float | None,
) -> str:
    """The text of a structure from its matrices (sparse, by name) and its kept nodes, reduced.

    Raises
    ------
    ConfigError : what cannot be used (``reduction``).
    """
    from spiral.physics.structures.reduction import reduce_structure

    sensors = [i for i, n in enumerate(table) if {*SENSORS} & {*n.uses}]
    forces = [i for i, n in enumerate(table) if {"input", "port"} & {*n.uses}] or sensors
    kept = [n.dof for n in table]
    size = min(size, matrices["M"].shape[0])
    _check_band(band, highest)
    ends = (float(band[0]), float(band[1]))
    reduction = reduce_structure(matrices, kept, size, ends, sensors, forces, highest)
    names = [n.name for n in table]
    told = {
        "names": [*names, *(f"mode_{i + 1}" for i in range(size - len(table)))],
        "units": [*(n.unit for n in table), *["m"] * (size - len(table))],
        "uses": [list(n.uses) for n in table],
        "pairs": _read_node_pairs(pairs or {}, names),
        "damping_ratio": float(damping_ratio),
        "full": matrices["M"].shape[0],
        "band_hz": list(reduction.band),
        "response_error": reduction.response_error,
        "frequency_error": reduction.frequency_error,
        "highest_hz": reduction.highest,
        "lowered": reduction.lowered,
        "matrices": {k: m.tolist() for k, m in reduction.matrices.items()},
    }
    return json.dumps(told)


def _check_band(band: Sequence[float], highest: float | None) -> None:
    if len(band) != 2 or not 0 <= band[0] < band[1]:
        raise ConfigError(
            f"band={list(band)}",
            "the low and the high frequency in Hz between which the record says something",
            "band=[0, 300]",
        )
    if highest is not None and highest < band[1]:
        raise ConfigError(
            f"highest={highest:g} below the end of the band, {band[1]:g} Hz",
            "a frequency in Hz above the band",
            "leave it out",
        )


def _read_node_pairs(given: Mapping[str, Any], names: list[str]) -> list[list[str]]:
    node_pairs = []
    for port, ends in given.items():
        pair = list(map(str, ends)) if isinstance(ends, list | tuple) else [str(ends)]
        for name in pair:
            if name not in names:
                raise ConfigError(f"pair {port}: {name!r}", f"of the nodes {', '.join(names)}",
                                  did_you_mean(name, names))  # fmt: skip
        if len(set(pair)) != 2:
            raise ConfigError(
                f"pair {port}: {pair}", "two nodes", f"{port}: [{', '.join(names[:2])}]"
            )
        node_pairs.append([str(port), *pair])
    return node_pairs


@lru_cache(maxsize=16)
def structure_of(text: str) -> StructureForm:
    """A structure from its text.

    Raises
    ------
    ConfigError : a text that ``describe_structure`` did not make.
    """
    try:
        given = json.loads(text)
        matrices = {k: np.array(v, dtype=float) for k, v in given["matrices"].items()}
        shapes = {m.shape for m in matrices.values()}
        if shapes != {(len(given["names"]),) * 2}:
            raise ValueError(f"matrices of shapes {shapes}")
        damping, ratio = matrices.get("C"), float(given["damping_ratio"])
        return StructureForm(
            names=tuple(given["names"]),
            units=tuple(given["units"]),
            uses=tuple(map(tuple, given["uses"])),
            pairs=tuple((str(p), str(a), str(b)) for p, a, b in given["pairs"]),
            mass=matrices["M"],
            stiffness=matrices["K"],
            parts={k[2:]: m for k, m in matrices.items() if k.startswith("K_")},
            damping=_unit_modal_damping(matrices) if damping is None else damping,
            by_ratio=damping is None,
            ratio=ratio,
            gyroscopic=matrices.get("G"),
            band=(float(given["band_hz"][0]), float(given["band_hz"][1])),
            report=_reduction_report(given),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"the text of a structure: {error}", "what spiral.structure made"
        ) from error


def _unit_modal_damping(matrices: Mapping[str, Array]) -> Array:
    from scipy.linalg import eigh

    from spiral.physics.structures.reduction import whole_stiffness

    mass = matrices["M"]
    values, modes = eigh(whole_stiffness(matrices), mass)
    sides = mass @ modes
    return 2 * (sides * np.sqrt(np.maximum(values, 0))) @ sides.T


def _reduction_report(given: Mapping[str, Any]) -> str:
    low, high = given["band_hz"]
    count = given.get("lowered", 0)
    modes = "1 mode above it was" if count == 1 else f"{count} modes above it were"
    lowered = f", to which {modes} lowered by mass" if count else ""
    return (
        f"{given['full']} degrees of freedom reduced to {len(given['names'])}: from {low:.4g} to "
        f"{high:.4g} Hz the response is off by {100 * given['response_error']:.2g} %, natural "
        f"frequencies by {100 * given['frequency_error']:.2g} % at most; the highest that is left "
        f"is {given['highest_hz']:.4g} Hz{lowered}"
    )
