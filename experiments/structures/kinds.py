"""Two large structures and ROSS's rotor: matrices, kept nodes, places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy import sparse

from experiments.structures.mesh import STEEL, Mesh, blocks, in_bending, plane_stress, tied


@dataclass(frozen=True)
class Kind:
    """A structure, and the test that is made of it.

    Parameters
    ----------
    matrices : M, K and, of what turns, G. nodes : name -> degree of freedom; its use.
    pairs : places between two nodes. band : of the record, Hz. speeds : least and most, rad/s.
    """

    name: str
    matrices: Mapping[str, sparse.csc_matrix]
    nodes: Mapping[str, Mapping[str, object]]
    pairs: Mapping[str, tuple[str, str]]
    band: tuple[float, float]
    rate: float
    drive: float
    speeds: tuple[float, float] | None = None

    @property
    def places(self) -> tuple[str, ...]:
        """Ports that the user lists: nodes against the ground, then pairs."""
        return (*(n for n, v in self.nodes.items() if "port" in str(v["use"])), *self.pairs)

    def using(self, use: str) -> tuple[str, ...]:
        """Nodes of a use."""
        return tuple(n for n, v in self.nodes.items() if use in str(v["use"]).split())


@cache
def beam() -> Kind:
    """A cantilever of 0.8 m with a bar of 0.5 m beside it, bolted together at the bar's tip."""
    long = _bar(0.8, 0.010, 320, 4, 0.0)
    short = _bar(0.5, 0.008, 200, 2, 1.0)
    parts = [plane_stress(long, 0.04), plane_stress(short, 0.04)]
    names = {"drive": (0, 0.2), "middle": (0, 0.5), "tip": (0, 0.8),
             "bar": (1, 0.25), "bar_tip": (1, 0.5)}  # fmt: skip
    meshes, offsets = (long, short), (0, 2 * len(long.points))
    groups = []
    for part, place in names.values():
        rows = offsets[part] + 2 * meshes[part].at(place)
        groups.append((rows, np.ones(len(rows))))
    held = [o + 2 * m.at(0.0)[:, None] + np.arange(2) for m, o in zip(meshes, offsets, strict=True)]
    matrices = _joined(parts, groups, np.concatenate([h.ravel() for h in held]))
    matrices["K"] = matrices["K"] + _spring(matrices["K"].shape[0], 2e4, 1, 4)
    uses = ("input port", "port", "sensor port", "sensor port", "port")
    nodes = {n: {"dof": i, "use": u} for i, (n, u) in enumerate(zip(names, uses, strict=True))}
    pairs = {"bolt": ("middle", "bar_tip"), "between": ("drive", "bar")}
    return Kind("beam", matrices, nodes, pairs, (0.0, 150.0), 600.0, 20.0)


def _bar(length: float, height: float, along: int, across: int, level: float) -> Mesh:
    """The second coordinate goes along the bar."""
    return blocks((level + np.linspace(0, height, across + 1), np.linspace(0, length, along + 1)))


@cache
def rotor() -> Kind:
    """A hollow shaft of 1 m with two disks, in bearings on a flexible base that moves in x."""
    along, across = np.linspace(0, 1, 251), np.array([0.005, 0.010, 0.015])
    disk = blocks(
        (across, along),
        (np.linspace(0.015, 0.06, 5), along[70:75]),
        (np.linspace(0.015, 0.08, 6), along[148:153]),
    )
    base = _bar(1.2, 0.03, 150, 2, 2.0)
    turning, resting = in_bending(disk), plane_stress(base, 0.06)
    size = 3 * len(disk.points)
    rings = {"shaft_1": 0.048, "seal": 0.448, "disk": 0.6, "shaft_2": 0.948}
    groups = [_ring(disk, z, plane * size) for plane in (0, 1) for z in rings.values()]
    for place in (0.152, 1.048):
        rows = 2 * size + 2 * base.at(place)
        groups.append((rows, np.ones(len(rows))))
    ends = np.concatenate([base.at(0.0), base.at(1.2)])
    held = (2 * size + 2 * ends[:, None] + np.arange(2)).ravel()
    matrices = _joined([turning, turning, resting], groups, held)
    matrices["G"] = _joined_gyroscopic(turning["G"], resting["K"].shape[0], groups, held)
    total = matrices["K"].shape[0]
    for first, second, stiffness in ((0, 8, 2e6), (3, 9, 2e6), (4, -1, 3e6), (7, -1, 3e6)):
        matrices["K"] = matrices["K"] + _spring(total, stiffness, first, second)
    kept = {"shaft_1": (0, ""), "seal": (1, "input port"), "disk": (2, "sensor port"),
            "shaft_2": (3, ""), "base_1": (8, "sensor port"), "base_2": (9, "port")}  # fmt: skip
    nodes = {n: {"dof": dof, "use": use or "end"} for n, (dof, use) in kept.items()}
    pairs = {"bearing_1": ("shaft_1", "base_1"), "bearing_2": ("shaft_2", "base_2")}
    return Kind("rotor", matrices, nodes, pairs, (0.0, 150.0), 600.0, 100.0, (60.0, 250.0))


def _ring(mesh: Mesh, z: float, offset: int) -> tuple[np.ndarray, np.ndarray]:
    """A section of the shaft that moves as a whole: U = a, V = -a."""
    nodes = mesh.at(z, below=0.015)
    rows = offset + np.concatenate([3 * nodes, 3 * nodes + 1])
    return rows, np.repeat([1.0, -1.0], len(nodes))


def _joined(parts, groups, held):
    """M and K of all parts, with the sections tied and the held rows gone."""
    whole = {k: sparse.block_diag([p[k] for p in parts], format="csc") for k in "MK"}
    basis = tied(whole["M"].shape[0], groups, held)
    return {k: (basis.T @ m @ basis).tocsc() for k, m in whole.items()}


def _joined_gyroscopic(one, resting, groups, held):
    """G between the planes; the base has none."""
    whole = sparse.bmat([[None, one], [-one, None]])
    whole = sparse.block_diag([whole, sparse.csc_matrix((resting, resting))], format="csc")
    basis = tied(whole.shape[0], groups, held)
    return (basis.T @ whole @ basis).tocsc()


def _spring(size: int, stiffness: float, first: int, second: int) -> sparse.csc_matrix:
    """Between two coordinates, or from one to the ground (-1)."""
    ends = [(first, 1.0), *([(second, -1.0)] if second >= 0 else [])]
    column = sparse.csc_matrix(
        ([s for _, s in ends], ([i for i, _ in ends], [0] * len(ends))), (size, 1)
    )
    return (stiffness * column @ column.T).tocsc()


@cache
def ross() -> Kind:
    """ROSS's example: a shaft of 1.5 m, two disks, bearings (R. Timbo et al. 2020, JOSS 5)."""
    with np.load(Path(__file__).with_name("ross_example.npz")) as file:
        matrices = {name: sparse.csc_matrix(file[name]) for name in file}
    uses = {"bearing_0": (0, "port"), "shaft_1": (1, "port"), "disk_2": (2, "input port"),
            "shaft_3": (3, "sensor port"), "disk_4": (4, "sensor port"),
            "shaft_5": (5, "end"), "bearing_6": (6, "end")}  # fmt: skip
    nodes = {name: {"dof": 4 * node, "use": use} for name, (node, use) in uses.items()}
    pairs = {"coupling": ("shaft_5", "bearing_6")}
    return Kind("ross", matrices, nodes, pairs, (0.0, 150.0), 600.0, 100.0, (60.0, 250.0))


KINDS = {"beam": beam, "rotor": rotor, "ross": ross}
__all__ = ["KINDS", "STEEL", "Kind"]
