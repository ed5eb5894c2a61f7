"""Long steps of ``filter.long_steps``, in one loop over those of a sample.

Slopes of a step are not carried on as whole matrices: what the rest adds to the linear part, a
kick K dX of few columns at each step, is felt at the later ones through the linear part alone,

    S_l = exp(l h A) + sum_{j < l} exp((l - 1 - j) h A) K_j dX_j,

of which only the rows S are needed before the last step.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.long_steps import FIRST_POINT, LONG_STEPS
from spiral.physics.lanes import INNER, LOOP

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_ROOM = types.Tuple((
    types.UniTuple(_F2, 4), types.UniTuple(_F3, 4), types.Tuple((_F2, _F1, _F2)),
    types.UniTuple(_F3, 2), _F1,
))  # fmt: skip
ADVANCE_LONG = types.FunctionType(
    types.boolean(
        *LONG_STEPS, _F1, _F2, types.int64, types.int64, _F1, types.int64[::1], _F2, _ROOM
    )
)
"""The type of ``advance_long``, which is compiled once and called by its address."""
_FAST = {"contract", "reassoc"}
_TRIES, _HALVINGS = 25, 8  # steps of Newton's method, and how often one is halved
_NEAR, _ENOUGH = 1e-11, 1e-8  # of the unknowns' scales, to which they are solved; or given up
_TINY = 1e-100


@nb.njit(cache=True, nogil=True)
def long_step_room(long, n, columns, inputs, keys, moved):
    """Arrays that ``advance_long`` works in: at both points of a step, and of all steps.

    Of n states, slopes f with so many ``columns``, ``inputs``, ``keys`` of all parameters, and
    those that slopes are by (``moved``).
    """
    moving, count = len(long[0]), long[4]
    m = 2 * moving
    at_points = (np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, inputs)))
    slopes = (
        np.zeros((2, n, n)), np.zeros((2, n, keys)), np.zeros((2, moved, n)),
        np.zeros((2, moving + moved, n)),
    )  # fmt: skip
    unknowns = np.zeros((4, m)), np.zeros(moving), np.zeros((m, m + columns))
    steps = np.zeros((count, m, n)), np.zeros((count, m, columns))
    return at_points, slopes, unknowns, steps, np.zeros(n)


@nb.njit(**INNER, fastmath=_FAST)
def _inputs_at(inputs, first, substeps, place, u):
    """Inputs at a share of a sample: the parabola through start, middle and end of a short step."""
    at = min(place * substeps, 1.0 * substeps)
    step = min(int(at), substeps - 1)
    share, row = at - step, first + 3 * step
    start, middle = (1 - share) * (1 - 2 * share), 4 * share * (1 - share)
    end = share * (2 * share - 1)
    for i in range(inputs.shape[1]):
        u[i] = start * inputs[row, i] + middle * inputs[row + 1, i] + end * inputs[row + 2, i]


@nb.njit(**INNER, fastmath=_FAST)
def _solve(m, count, width):
    """X of M X = B in place: ``m`` (count, count + width) is [M | B], and B becomes X."""
    for i in range(count):
        best = i
        for r in range(i + 1, count):
            if abs(m[r, i]) > abs(m[best, i]):
                best = r
        if not abs(m[best, i]) > 0.0:
            return False
        if best != i:
            for c in range(i, count + width):
                m[i, c], m[best, c] = m[best, c], m[i, c]
        for r in range(i + 1, count):
            factor = m[r, i] / m[i, i]
            for c in range(i, count + width):
                m[r, c] -= factor * m[i, c]
    for i in range(count - 1, -1, -1):
        for c in range(count, count + width):
            for r in range(i + 1, count):
                m[i, c] -= m[i, r] * m[r, c]
            m[i, c] /= m[i, i]
    return True


@nb.njit(**INNER, fastmath=_FAST)
def _misses(rest, moving, gains, values, at_points, rests, y, held, misses):
    """What is left of the equation at both points with the unknowns y: y - c - sum_j G_ij r_j."""
    count, (points, _, forces, u) = len(moving), at_points
    for i in range(2):
        for s in range(count):
            points[i, moving[s]] = y[i * count + s]
        rest(points[i], u[i], values, forces[i], rests[i], rests[i])
    for i in range(2):
        for s in range(count):
            row, value = moving[s], y[i * count + s] - held[i * count + s]
            for j in range(2):
                for b in range(forces.shape[1]):
                    value -= gains[i, j, row, b] * forces[j, b]
            misses[i * count + s] = value


@nb.njit(**INNER)
def _relative_size(values, scales):
    """The largest of the unknowns' values over the scales of their states; infinite for NaN."""
    largest = 0.0
    for a in range(len(values)):
        size = abs(values[a]) / scales[a % len(scales)]
        if not size <= largest:
            largest = size if size > largest else np.inf
    return largest


@nb.njit(**INNER, fastmath=_FAST)
def _equation_slopes(moving, gains, rests, gathered, equation):
    """Slopes of what ``_misses`` gives by the unknowns: 1 - G_ij r_x.

    ``gathered`` (2, S, n) out: the columns S of r_x as rows.
    """
    few, n = len(moving), rests.shape[1]
    for j in range(2):
        for t in range(few):
            for b in range(n):
                gathered[j, t, b] = rests[j, b, moving[t]]
    for i in range(2):
        for s in range(few):
            a = i * few + s
            for j in range(2):
                for t in range(few):
                    value = 0.0
                    for b in range(n):
                        value += gains[i, j, moving[s], b] * gathered[j, t, b]
                    equation[a, j * few + t] = (1.0 if a == j * few + t else 0.0) - value


@nb.njit(**INNER, fastmath=_FAST)
def _find_points(rest, moving, gains, values, at_points, rests, gathered, unknowns):
    """Newton's method for the states S at both points, its steps halved until they lead nearer."""
    (vectors, scales, equation), count = unknowns, 2 * len(moving)
    y, held, misses, step = vectors[0], vectors[1], vectors[2], vectors[3]
    _misses(rest, moving, gains, values, at_points, rests, y, held, misses)
    for a in range(count):  # what all forces as they are would make of a state
        scales[a % len(scales)] = max(
            scales[a % len(scales)], abs(y[a] - misses[a]), abs(y[a]), _TINY
        )
    size = _relative_size(misses, scales)
    for _ in range(_TRIES):
        if size <= _NEAR:
            return True
        _equation_slopes(moving, gains, rests, gathered, equation)
        for a in range(count):
            equation[a, count] = misses[a]
        if not _solve(equation, count, 1):
            return False
        for a in range(count):
            step[a] = equation[a, count]
            y[a] -= step[a]
        before = size
        for _ in range(_HALVINGS):
            _misses(rest, moving, gains, values, at_points, rests, y, held, misses)
            size = _relative_size(misses, scales)
            if size < before or size <= _NEAR:
                break
            for a in range(count):
                step[a] *= 0.5
                y[a] += step[a]
        if not size < before and not size <= _NEAR:
            return before <= _ENOUGH
    return size <= _ENOUGH


@nb.njit(**INNER, fastmath=_FAST)
def _fill_points(gains, at_points, x):
    """X_i at both points from what is known of them; x becomes the second one."""
    points, held, forces, _ = at_points
    for i in range(2):
        for a in range(gains.shape[2]):
            value = held[i, a]
            for j in range(2):
                for b in range(gains.shape[2]):
                    value += gains[i, j, a, b] * forces[j, b]
            points[i, a] = value
    for a in range(gains.shape[2]):
        x[a] = points[1, a]


@nb.njit(**INNER, fastmath=_FAST)
def _point_slopes(step, moving, heads, gains, both, slopes, equation, steps):
    """dX_i of the states S at both points by all columns, behind the equation's own slopes."""
    rests, sources, own, gathered = slopes
    (kicks, felt), few, n = steps, len(moving), heads.shape[3]
    count, columns = 2 * few, felt.shape[2]
    _equation_slopes(moving, gains, rests, gathered, equation)
    for j in range(2):
        for c in range(len(both)):
            for b in range(n):
                gathered[j, few + c, b] = sources[j, b, both[c]]
    for i in range(2):
        for s in range(few):
            a = i * few + s
            for c in range(columns):
                equation[a, count + c] = heads[i, step, s, c] if c < n else 0.0
            for j in range(step):
                for t in range(count):
                    weight = 0.0
                    for b in range(n):
                        weight += heads[i, step - 1 - j, s, b] * kicks[j, t, b]
                    for c in range(columns):
                        equation[a, count + c] += weight * felt[j, t, c]
            for c in range(len(both)):
                value = 0.0
                for b in range(n):
                    value += heads[i, 0, s, b] * own[0, c, b]
                for j in range(2):
                    for b in range(n):
                        value += gains[i, j, moving[s], b] * gathered[j, few + c, b]
                equation[a, count + n + c] += value
    if not _solve(equation, count, columns):
        return False
    for t in range(count):
        for c in range(columns):
            felt[step, t, c] = equation[t, count + c]
    return True


@nb.njit(**INNER, fastmath=_FAST)
def _keep_step(step, moving, flow, gains, slopes, steps):
    """K of a step, and what the parameters alone have made of x by its end (``own``)."""
    (_, _, own, gathered), (kicks, _), few, n = slopes, steps, len(moving), flow.shape[0]
    for a in range(n):
        for j in range(2):
            for t in range(few):
                value = 0.0
                for b in range(n):
                    value += gains[1, j, a, b] * gathered[j, t, b]
                kicks[step, j * few + t, a] = value
        for c in range(own.shape[1]):
            value = 0.0
            for b in range(n):
                value += flow[a, b] * own[0, c, b]
            for j in range(2):
                for b in range(n):
                    value += gains[1, j, a, b] * gathered[j, few + c, b]
            own[1, c, a] = value
    for c in range(own.shape[1]):
        for a in range(n):
            own[0, c, a] = own[1, c, a]


@nb.njit(**INNER, fastmath=_FAST)
def _sum_steps(flows, count, own, steps, f):
    """S at the end of the sample."""
    (kicks, felt), n = steps, f.shape[0]
    for a in range(n):
        for c in range(f.shape[1]):
            f[a, c] = flows[count, a, c] if c < n else 0.0
        for c in range(own.shape[1]):
            f[a, n + c] = own[0, c, a]
        for j in range(count):
            for t in range(kicks.shape[1]):
                weight = 0.0
                for b in range(n):
                    weight += flows[count - 1 - j, a, b] * kicks[j, t, b]
                for c in range(f.shape[1]):
                    f[a, c] += weight * felt[j, t, c]


@nb.njit(**INNER, fastmath=_FAST)
def _begin_step(step, moving, flows, count, x, inputs, first, substeps, at_points, vectors):
    """Inputs at both points, what the linear part makes of x there, and the first guess: x."""
    _, held, _, u = at_points
    few = len(moving)
    for i in range(2):
        part = (step + (FIRST_POINT if i == 0 else 1.0)) / count
        _inputs_at(inputs, first, substeps, part, u[i])
        flow = flows[count + 1] if i == 0 else flows[1]
        for a in range(flows.shape[1]):
            value = 0.0
            for b in range(flows.shape[1]):
                value += flow[a, b] * x[b]
            held[i, a] = value
        for s in range(few):
            vectors[0, i * few + s] = x[moving[s]]
            vectors[1, i * few + s] = held[i, moving[s]]


@nb.njit(ADVANCE_LONG.signature, **LOOP, fastmath=_FAST)
def advance_long(rest, sources_of, long, x, inputs, k, substeps, values, both, f, room):
    """x a sample on by long steps, and its slopes f by states and the parameters ``both``.

    rest, sources_of, long : ``LongSteps.fields``. False where an equation is not solved: x
    is as it was.
    """
    moving, flows, heads, gains, count = long
    at_points, slopes, unknowns, steps, begun = room
    points, _, forces, u = at_points
    for a in range(len(begun)):
        begun[a] = x[a]
    slopes[2][:] = 0.0
    for step in range(count):
        _begin_step(step, moving, flows, count, x, inputs, 3 * k * substeps, substeps, at_points,
                    unknowns[0])  # fmt: skip
        solved = _find_points(
            rest, moving, gains, values, at_points, slopes[0], slopes[3], unknowns
        )
        if solved:
            _fill_points(gains, at_points, x)
            if len(both) > 0:
                for i in range(2):
                    sources_of(points[i], u[i], values, forces[i], slopes[0][i], slopes[1][i])
            solved = _point_slopes(step, moving, heads, gains, both, slopes, unknowns[2], steps)
        if not solved:
            for a in range(len(begun)):
                x[a] = begun[a]
            return False
        _keep_step(step, moving, flows[1], gains, slopes, steps)
    _sum_steps(flows, count, slopes[2], steps, f)
    return True
