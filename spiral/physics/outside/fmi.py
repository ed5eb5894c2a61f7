"""The rates of an FMU (model exchange, FMI 2.0 or 3.0) by calls of its C functions, compiled.

    x' = f(t, x, u, p),    slopes by directional derivatives where the FMU has them, else
    df/da ~ (f(a + h) - f(a - h)) / 2h,    h = 1e-7 max(|a|, nominal)

Arguments are states, inputs, parameters and time, in this order. Parameters are set in event mode,
as the standard asks, and only where they changed; an FMU with event indicators is taken through
event mode at every call, so that its relations follow the states. A call that fails gives NaN.
Each thread takes an instance of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum, auto

import numba as nb
import numpy as np

from spiral.physics.outside.calls import KERNEL, carray, exchanged, invoke

STEP = 1e-7
NONE, DIRECTIONAL, DIFFERENCE = range(3)
"""How the slope by an argument is found; by the time there is none."""


class Slot(IntEnum):
    """Positions at the head of the kernel's integers: sizes, addresses of functions, offsets."""

    TOTAL = 0
    NUMBERS = auto()
    VERSION = auto()
    INSTANCES = auto()
    STATES = auto()
    INPUTS = auto()
    PARAMETERS = auto()
    EVENTS = auto()
    SET_TIME = auto()
    SET_STATES = auto()
    SET_VALUES = auto()
    RATES = auto()
    DIRECTION = auto()
    EVENT_MODE = auto()
    UPDATE = auto()
    CONTINUOUS = auto()
    KINDS = auto()  # place of the kinds of slope, one for each argument
    REFERENCES = auto()  # of the arguments but time: whole numbers of 32 bits
    UNKNOWNS = auto()  # of the rates, alike
    HANDLES = auto()
    LOCKS = auto()
    ROOM = auto()  # for what an update of discrete states tells


FUNCTIONS = {
    2: ("fmi2SetTime", "fmi2SetContinuousStates", "fmi2SetReal", "fmi2GetDerivatives",
        "fmi2GetDirectionalDerivative", "fmi2EnterEventMode", "fmi2NewDiscreteStates",
        "fmi2EnterContinuousTimeMode"),
    3: ("fmi3SetTime", "fmi3SetContinuousStates", "fmi3SetFloat64",
        "fmi3GetContinuousStateDerivatives", "fmi3GetDirectionalDerivative",
        "fmi3EnterEventMode", "fmi3UpdateDiscreteStates", "fmi3EnterContinuousTimeMode"),
}  # fmt: skip
"""By the version of FMI, in the order of the slots from SET_TIME on."""
_COUNT, _WIDE, _FAILED = len(Slot), 16, 2
(_TOTAL, _NUMBERS, _VERSION, _INSTANCES, _STATES, _INPUTS, _PARAMETERS, _EVENTS, _SET_TIME,
 _SET_STATES, _SET_VALUES, _RATES, _DIRECTION, _EVENT_MODE, _UPDATE, _CONTINUOUS, _KINDS,
 _REFERENCES, _UNKNOWNS, _HANDLES, _LOCKS, _ROOM) = map(int, Slot)  # fmt: skip


def kernel_memory(
    version: int,
    addresses: Sequence[int],
    handles: Sequence[int],
    references: Mapping[str, Sequence[int]],
    nominals: Sequence[float],
    events: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Arrays of integers and floats for a kernel; slopes by differences, but none by the time.

    Parameters
    ----------
    addresses : of ``FUNCTIONS[version]``. handles : of instances in continuous-time mode.
    references : value references of ``rates``, ``states``, ``inputs``, ``parameters``.
    nominals : sizes of the states, of the inputs, of the parameters.
    """
    sizes = [len(references[k]) for k in ("states", "inputs", "parameters")]
    count, instances = sum(sizes) + 1, len(handles)
    known = [r for k in ("states", "inputs", "parameters") for r in references[k]]
    parts = {
        _KINDS: np.array([DIFFERENCE] * (count - 1) + [NONE]),
        _REFERENCES: _pack_references(known),
        _UNKNOWNS: _pack_references(references["rates"]),
        _HANDLES: np.array(handles),
        _LOCKS: np.zeros(instances),
        _ROOM: np.zeros(instances * _WIDE),
    }
    head = np.zeros(_COUNT, dtype=np.int64)
    head[[_VERSION, _INSTANCES, _EVENTS]] = version, instances, events
    head[[_STATES, _INPUTS, _PARAMETERS]] = sizes
    head[_SET_TIME : _CONTINUOUS + 1] = addresses
    place = _COUNT
    for slot, part in parts.items():
        head[slot], place = place, place + len(part)
    own = 2 * sizes[0] + sizes[2] + 1
    numbers = np.full(count + instances * own, np.nan)
    numbers[:count] = [*nominals, 1.0]
    head[[_TOTAL, _NUMBERS]] = place, len(numbers)
    return np.concatenate([head, *(p.astype(np.int64) for p in parts.values())]), numbers


def set_slope_kinds(whole: np.ndarray, kinds: Sequence[int]) -> None:
    """Say how the slope by each argument is found."""
    whole[whole[_KINDS] : whole[_KINDS] + len(kinds)] = kinds


def _pack_references(values: Sequence[int]) -> np.ndarray:
    """Whole numbers of 32 bits in a row, as whole numbers of 64."""
    short = np.zeros(2 * (len(values) // 2 + 1), dtype=np.uint32)
    short[: len(values)] = values
    return short.view(np.int64)


@nb.njit(nogil=True)
def _word_address(w, place):
    """The address of a whole number."""
    return w.ctypes.data + 8 * place


@nb.njit(nogil=True)
def _set_values(w, handle, first, values):
    """Set arguments from the first on."""
    count = len(values)
    if count == 0:
        return 0
    place, at = _word_address(w, w[_REFERENCES]) + 4 * first, values.ctypes.data
    if w[_VERSION] == 3:
        return invoke(w[_SET_VALUES], (handle, place, count, at, count))
    return invoke(w[_SET_VALUES], (handle, place, count, at))


@nb.njit(nogil=True)
def _update_discrete_states(w, handle, k):
    """Discrete states brought up to date, in event mode."""
    worst, room = 0, w[_ROOM] + _WIDE * k
    at = _word_address(w, room)
    for _ in range(10):
        w[room] = 0
        if w[_VERSION] == 3:
            given = (handle, at, at + 8, at + 16, at + 24, at + 32, at + 40)
            worst = max(worst, invoke(w[_UPDATE], given))
            again = w[room] & 0xFF
        else:
            worst = max(worst, invoke(w[_UPDATE], (handle, at)))
            again = w[room] & 0xFFFFFFFF
        if again == 0 or worst >= _FAILED:
            break
    return worst


@nb.njit(nogil=True)
def _evaluate_rates(w, k, a, known, f):
    """f at the arguments, by an instance whose parameters are ``known``; the worst status."""
    handle = w[w[_HANDLES] + k]
    n, nu = w[_STATES], w[_INPUTS]
    worst = invoke(w[_SET_TIME], (handle, a[-1]))
    worst = max(worst, invoke(w[_SET_STATES], (handle, a.ctypes.data, n)))
    worst = max(worst, _set_values(w, handle, n, a[n : n + nu]))
    p = a[n + nu : -1]
    changed = False
    for i in range(len(p)):
        changed = changed or known[i] != p[i]
    if changed or w[_EVENTS]:
        worst = max(worst, invoke(w[_EVENT_MODE], (handle,)))
        if changed:
            worst = max(worst, _set_values(w, handle, n + nu, p))
            known[:] = p
        worst = max(worst, _update_discrete_states(w, handle, k))
        worst = max(worst, invoke(w[_CONTINUOUS], (handle,)))
    return max(worst, invoke(w[_RATES], (handle, f.ctypes.data, n)))


@nb.njit(nogil=True)
def _directional_slope(w, handle, column, one, f):
    """The slope of f by an argument: the FMU's directional derivative at its present point."""
    n = w[_STATES]
    place, unknowns = _word_address(w, w[_REFERENCES]) + 4 * column, _word_address(w, w[_UNKNOWNS])
    seed, into = one.ctypes.data, f.ctypes.data
    if w[_VERSION] == 3:
        return invoke(w[_DIRECTION], (handle, unknowns, n, place, 1, seed, 1, into, n))
    return invoke(w[_DIRECTION], (handle, unknowns, n, place, 1, seed, into))


@nb.njit(nogil=True)
def _difference_slope(w, k, a, column, nominal, known, low, f):
    """The slope of f by an argument, by a central difference of two more calls."""
    here = a[column]
    step = STEP * max(abs(here), nominal)
    a[column] = here - step
    worst = _evaluate_rates(w, k, a, known, low)
    a[column] = here + step
    worst = max(worst, _evaluate_rates(w, k, a, known, f))
    a[column] = here
    for i in range(len(f)):
        f[i] = (f[i] - low[i]) / (2.0 * step)
    return worst


@nb.njit(nogil=True)
def _acquire_instance(w):
    """Lock an instance that no other thread uses, and return its number."""
    k = 0
    while not exchanged(_word_address(w, w[_LOCKS] + k), 0, 1):
        k = (k + 1) % w[_INSTANCES]
    return k


@nb.njit(nogil=True)
def _evaluate_with_slopes(w, z, a, columns, values, slopes):
    """Values and slopes, by one instance."""
    n, count, own = w[_STATES], len(a), 2 * w[_STATES] + w[_PARAMETERS] + 1
    k = _acquire_instance(w)
    mine = z[count + k * own : count + (k + 1) * own]
    known, low, one = mine[2 * n : -1], mine[:n], mine[-1:]
    one[0] = 1.0
    worst = _evaluate_rates(w, k, a, known, values)
    for turn in (DIRECTIONAL, DIFFERENCE):  # differences move the point
        for i in range(len(columns)):
            column = columns[i]
            kind = w[w[_KINDS] + column]
            if kind == NONE:
                slopes[i, :] = 0.0
            elif kind == turn and turn == DIRECTIONAL:
                worst = max(
                    worst, _directional_slope(w, w[w[_HANDLES] + k], column, one, slopes[i])
                )
            elif kind == turn:
                worst = max(
                    worst, _difference_slope(w, k, a, column, z[column], known, low, slopes[i])
                )
    exchanged(_word_address(w, w[_LOCKS] + k), 1, 0)
    if worst >= _FAILED:
        values[:] = np.nan
        slopes[:, :] = np.nan


@nb.cfunc(KERNEL, cache=True)
def kernel(whole, numbers, given, columns, count, values, slopes):
    """Values and slopes of the rates (``calls.KERNEL``)."""
    w = carray(whole, carray(whole, _COUNT)[_TOTAL])
    n, size = w[_STATES], w[_STATES] + w[_INPUTS] + w[_PARAMETERS] + 1
    _evaluate_with_slopes(
        w, carray(numbers, w[_NUMBERS]), carray(given, size), carray(columns, count),
        carray(values, n), carray(slopes, (count, n)),
    )  # fmt: skip
