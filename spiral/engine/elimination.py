"""Linear algebra of a pass: initial states eliminated, blocks kept for covariances."""

from __future__ import annotations

import numpy as np

from spiral.types.record import Array

RANK = 1e-9  # relative singular value under which a direction of the initial state is unseen


def eliminate_initial_states(triangle: Array, n: int) -> tuple[Array, Array, int]:
    """Project the first n columns out of each window's triangle, as far as they have rank."""
    head, tail = triangle[:, :n, :n], triangle[:, :n, n:]
    scale = np.linalg.norm(head, axis=1, keepdims=True)
    scale[scale == 0] = 1.0
    left, values, right = np.linalg.svd(head / scale)
    seen = values > RANK * values[:, :1]
    rotated = np.swapaxes(left, 1, 2) @ tail
    inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    eliminated = np.swapaxes(right, 1, 2) @ (inverse[:, :, None] * rotated)
    eliminated /= np.swapaxes(scale, 1, 2)
    unseen = np.where(seen[:, :, None], 0.0, rotated)
    rows = np.concatenate([unseen, triangle[:, n:, n:]], axis=1)
    return rows.reshape(-1, tail.shape[2]), eliminated, int(seen.sum())


def gram_matrices(rows: Array, size: int) -> Array:
    """Gram matrices of consecutive groups of ``size`` rows in each window."""
    count, total, width = rows.shape
    size = min(size, total)
    whole = total // size
    cutoff = (whole - 1) * size
    body = rows[:, :cutoff].reshape(count, whole - 1, size, width)
    last = rows[:, cutoff:]  # a short rest is joined to the last group
    joined = (np.swapaxes(last, -1, -2) @ last)[:, None]
    if whole == 1:
        return joined
    return np.concatenate([np.swapaxes(body, -1, -2) @ body, joined], axis=1)


def project_gram_matrices(grams: Array, eliminated: Array) -> Array:
    """T^T G T with T = [-elimination; identity], for every block of every window."""
    count, _, size = eliminated.shape
    transform = np.concatenate([-eliminated, np.broadcast_to(np.eye(size), (count, size, size))], 1)
    return np.swapaxes(transform, 1, 2)[:, None] @ grams @ transform[:, None]


def merge_blocks(grams: Array, block: int, length: int) -> Array:
    """Blocks of all windows in order; short windows are added up to whole blocks."""
    flat = grams.reshape(-1, *grams.shape[2:])
    group = max(1, block // length)
    flat = flat[np.abs(flat[:, -1, -1]) > 0]
    if group == 1 or len(flat) < 2:
        return flat
    edges = np.arange(0, len(flat), group)
    return np.add.reduceat(flat, edges, axis=0)


def scatter_columns(rows: Array, seen: Array, width: int) -> Array:
    """Rows of one record's columns among all columns."""
    if len(seen) == width:
        return rows
    full = np.zeros((len(rows), width))
    full[:, seen] = rows
    return full


def scatter_blocks(grams: Array, seen: Array, width: int) -> Array:
    """Gram blocks of one record's columns among all columns."""
    if len(seen) == width:
        return grams
    full = np.zeros((len(grams), width, width))
    full[:, seen[:, None], seen[None, :]] = grams
    return full


def triangle_of(rows: Array) -> Array:
    """R of the QR decomposition, of one matrix (then square) or of a stack."""
    count, width = rows.shape[-2:]
    if rows.ndim == 2 and count < width:
        rows = np.concatenate([rows, np.zeros((width - count, width))])
    return np.asarray(np.linalg.qr(rows, mode="r"))
