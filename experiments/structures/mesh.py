"""Finite elements of eight nodes: plane stress, and bodies of revolution in bending.

    plane stress:    u = (u_x, u_y)(x, y)
    in bending:      u_r = U(r, z) cos t,  u_t = V(r, z) sin t,  u_z = W(r, z) cos t,

the first harmonic of a body that is round about z, and the same turned by a right angle for the
other plane (O. C. Zienkiewicz, R. L. Taylor, The Finite Element Method, vol. 2, 5th ed., ch. 9). A
section that moves as a whole has U = -V. At w rad/s about its axis such a body has the matrix w G
between its planes, G = 2 pi rho int r [(U + V)(U + V) + W W] (M. Geradin, N. Kill, Eng. Comput. 1,
1984).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

Array = np.ndarray
STEEL = (2.1e11, 0.3, 7850.0)
"""Young's modulus in Pa, Poisson's ratio, density in kg/m^3."""


@dataclass(frozen=True)
class Mesh:
    """Places of nodes (nodes, 2), and the eight nodes of each element, corners first."""

    points: Array
    elements: Array

    def at(self, second: float, below: float = np.inf) -> Array:
        """Nodes of a section: with this second coordinate, the first at most ``below``."""
        chosen = np.isclose(self.points[:, 1], second, atol=1e-9)
        return np.flatnonzero(chosen & (self.points[:, 0] <= below + 1e-9))


def blocks(*grids: tuple[Array, Array]) -> Mesh:
    """Rectangles, each with the lines of its elements in both directions; shared nodes are one."""
    places, cells = [], []
    for first, second in grids:
        a, b = (g[:, None] for g in np.meshgrid(first[:-1], second[:-1], indexing="ij"))
        c, d = (g[:, None] for g in np.meshgrid(first[1:], second[1:], indexing="ij"))
        x = np.stack([a, c, c, a, (a + c) / 2, c, (a + c) / 2, a], axis=-1).reshape(-1, 8)
        y = np.stack([b, b, d, d, b, (b + d) / 2, d, (b + d) / 2], axis=-1).reshape(-1, 8)
        places.append(np.stack([x, y], axis=-1))
    corners = np.concatenate(places)
    points, index = np.unique(corners.reshape(-1, 2).round(9), axis=0, return_inverse=True)
    cells = index.reshape(-1, 8)
    return Mesh(points, cells)


def _shapes(a: float, b: float) -> tuple[Array, Array]:
    """The eight functions at a point of the square, and their slopes (2, 8)."""
    s, t = np.array([-1, 1, 1, -1]), np.array([-1, -1, 1, 1])
    p, q = 1 + a * s, 1 + b * t
    corner = p * q * (a * s + b * t - 1) / 4
    by_a = s * q * (2 * a * s + b * t) / 4
    by_b = t * p * (a * s + 2 * b * t) / 4
    sides = [(1 - a * a) * (1 - b) / 2, (1 + a) * (1 - b * b) / 2,
             (1 - a * a) * (1 + b) / 2, (1 - a) * (1 - b * b) / 2]  # fmt: skip
    sides_a = [-a * (1 - b), (1 - b * b) / 2, -a * (1 + b), -(1 - b * b) / 2]
    sides_b = [-(1 - a * a) / 2, -b * (1 + a), (1 - a * a) / 2, -b * (1 - a)]
    slopes = np.array([np.r_[by_a, sides_a], np.r_[by_b, sides_b]])
    return np.r_[corner, sides], slopes


def _points(mesh: Mesh) -> list[tuple[Array, Array, Array, Array]]:
    """At each of 3 x 3 points of Gauss: shapes, their slopes, the weights, the first coordinate."""
    places, weights = np.polynomial.legendre.leggauss(3)
    corners, found = mesh.points[mesh.elements], []
    for a, wa in zip(places, weights, strict=True):
        for b, wb in zip(places, weights, strict=True):
            shape, slope = _shapes(a, b)
            jacobian = np.einsum("ij,ejk->eik", slope, corners)
            gradient = np.linalg.solve(jacobian, np.broadcast_to(slope, (len(corners), 2, 8)))
            area = wa * wb * np.linalg.det(jacobian)
            found.append((shape, gradient, area, corners[:, :, 0] @ shape))
    return found


def _gathered(mesh: Mesh, parts: Array, fields: int) -> sparse.csc_matrix:
    """A matrix from those of the elements."""
    rows = (fields * mesh.elements[:, :, None] + np.arange(fields)).reshape(len(parts), -1)
    size, count = fields * len(mesh.points), rows.shape[1]
    i, j = np.repeat(rows, count, axis=1), np.tile(rows, (1, count))
    return sparse.coo_matrix((parts.ravel(), (i.ravel(), j.ravel())), (size, size)).tocsc()


def plane_stress(mesh: Mesh, width: float, material=STEEL) -> dict[str, sparse.csc_matrix]:
    """M and K of a sheet of this width; two degrees of freedom for each node."""
    modulus, ratio, density = material
    law = (
        modulus / (1 - ratio**2) * np.array([[1, ratio, 0], [ratio, 1, 0], [0, 0, (1 - ratio) / 2]])
    )
    count = len(mesh.elements)
    mass, stiffness = np.zeros((2, count, 16, 16))
    for shape, gradient, area, _ in _points(mesh):
        strain = np.zeros((count, 3, 16))
        strain[:, 0, 0::2] = strain[:, 2, 1::2] = gradient[:, 0]
        strain[:, 1, 1::2] = strain[:, 2, 0::2] = gradient[:, 1]
        moved = np.kron(shape, np.eye(2))
        stiffness += np.einsum(
            "e,eki,kl,elj->eij", width * area, strain, law, strain, optimize=True
        )
        mass += (width * density * area)[:, None, None] * (moved.T @ moved)
    return {"M": _gathered(mesh, mass, 2), "K": _gathered(mesh, stiffness, 2)}


def in_bending(mesh: Mesh, material=STEEL) -> dict[str, sparse.csc_matrix]:
    """M, K and the part of G of one plane; U, V, W for each node at (r, z)."""
    modulus, ratio, density = material
    shear, lame = modulus / (2 + 2 * ratio), modulus * ratio / (1 + ratio) / (1 - 2 * ratio)
    law = np.diag([2 * shear] * 3 + [shear] * 3)
    law[:3, :3] += lame
    count = len(mesh.elements)
    mass, stiffness, gyroscopic = np.zeros((3, count, 24, 24))
    for shape, gradient, area, radius in _points(mesh):
        by_r, by_z, over_r = gradient[:, 0], gradient[:, 1], shape / radius[:, None]
        strain = np.zeros((count, 6, 24))
        strain[:, 0, 0::3] = by_r
        strain[:, 1, 0::3] = strain[:, 1, 1::3] = over_r
        strain[:, 2, 2::3] = by_z
        strain[:, 3, 0::3], strain[:, 3, 2::3] = by_z, by_r
        strain[:, 4, 0::3], strain[:, 4, 1::3] = -over_r, by_r - over_r
        strain[:, 5, 1::3], strain[:, 5, 2::3] = by_z, -over_r
        weight = np.pi * radius * area
        stiffness += np.einsum("e,eki,kl,elj->eij", weight, strain, law, strain, optimize=True)
        moved = np.kron(shape, np.eye(3))
        turned = np.stack([np.kron(shape, [1, 1, 0]), np.kron(shape, [0, 0, 1])])
        mass += (density * weight)[:, None, None] * (moved.T @ moved)
        gyroscopic += (2 * density * weight)[:, None, None] * (turned.T @ turned)
    parts = {"M": mass, "K": stiffness, "G": gyroscopic}
    return {name: _gathered(mesh, part, 3) for name, part in parts.items()}


def tied(size: int, groups: list[tuple[Array, Array]], held: Array) -> sparse.csc_matrix:
    """T of q = T q_left: each group (rows, signs) moves as one, rows ``held`` not at all.

    The coordinates of the groups are the first columns, in their order.
    """
    left = np.ones(size, dtype=bool)
    left[held] = False
    rows, columns, values = [], [], []
    for number, (members, signs) in enumerate(groups):
        left[members] = False
        rows.append(members)
        columns.append(np.full(len(members), number))
        values.append(signs)
    others = np.flatnonzero(left)
    rows.append(others)
    columns.append(len(groups) + np.arange(len(others)))
    values.append(np.ones(len(others)))
    place = (np.concatenate(rows), np.concatenate(columns))
    shape = (size, len(groups) + len(others))
    return sparse.coo_matrix((np.concatenate(values).astype(float), place), shape).tocsc()
