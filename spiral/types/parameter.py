"""Parameters, states and inputs: every quantity of a model that has a name and a unit."""

from __future__ import annotations

import keyword
from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from typing import Literal

from spiral.types.errors import PluginError
from spiral.types.rates import per_second

Role = Literal["amplitude", "shape"]
Scope = Literal["machine", "record"]


def _check_name(kind: str, name: str) -> None:
    if not name.isidentifier() or keyword.iskeyword(name):
        reserved = keyword.iskeyword(name)
        raise PluginError(
            f"{'an' if kind == 'input' else 'a'} {kind} named {name!r}"
            + (", a word of Python's own" if reserved else ""),
            "a Python identifier in snake_case, for instance 'stiffness'",
            f"rename the {kind}" + (f", for instance {name}_1" if reserved else ""),
        )


@dataclass(frozen=True)
class Parameter:
    """A number of a model, with its unit and bounds.

    Parameters
    ----------
    name : identifier, unique inside its owner.
    unit : relative to the port, e.g. ``force/position^3`` (words: force, position, velocity),
        or absolute, e.g. ``kg*m^2``.
    lower, upper : bounds; a zero lower bound makes its test one-sided.
    start : first value; ``None`` lets the fit find one.
    role : ``amplitude`` enters linearly and is zero when its effect is absent; ``shape`` (gap,
        width, frequency) means nothing while the amplitude is zero and is fixed unless freed.
    per_axis : one value for each axis of the port.
    scope : ``machine`` is shared by all records, ``record`` is a nuisance of each record.
    grid : of a shape, the values tried while its effect is absent, as shares of the largest
        port position or velocity (by its unit) that the record shows; of another unit (a
        frequency), the values themselves.
    centre : of a shape with a grid, its scale is the middle of what the port's position covers,
        where that is farther from zero than it is wide, else zero; without a ``start`` the effect
        is then not tried.
    two_sided : of a shape with a grid, its effect is tried where the port's position goes to both
        sides of zero, each by a fifth of the other at least.
    spread : of a shape with a grid, its scale is how far the port's position goes from that middle.
    most : of a shape with a grid, a value in the unit of its grid, beyond which the effect is no
        longer what its name says (a corner rounded over the whole motion). It is told with such a
        value only where it leaves nothing but noise.
    loose : one of many coefficients of a curve, some of which a record may hardly determine: its
        prior has mean zero and the standard deviation with which, where it is seen best, it alone
        would make the whole response.
    choice : of a shape with a grid, it is one of these values and nothing between (where the zero
        of a unit lies): no fit frees it.
    repeats : of a shape with a grid, how often its effect repeats for one unit of the port's
        position; the default strategy also looks beyond the grid, as far as the records show it.
    search : each value of a grid of frequencies moves, by at most this share of it, to the
        strongest spectral line of the records' channels.
    spectrum : of a shape of an effect with states of its own, in Hz or s: its values are laid at
        the peaks of the residual's spectrum (``spiral.inference.strategies.shooting.resonances``),
        in s as 1 / (2 pi f).
    """

    name: str
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    start: float | None = None
    role: Role = "amplitude"
    per_axis: bool = False
    scope: Scope = "machine"
    grid: tuple[float, ...] = ()
    search: float = 0.0
    spectrum: bool = False
    loose: bool = False
    most: float | None = None
    centre: bool = False
    choice: bool = False
    spread: bool = False
    two_sided: bool = False
    repeats: bool = False

    def __post_init__(self) -> None:
        _check_name("parameter", self.name)
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise PluginError(
                f"parameter {self.name!r} with bounds [{self.lower}, {self.upper}]",
                "a lower bound below the upper bound",
            )

    def at_bound(self, value: float) -> bool:
        """Whether a value lies at a bound that is not zero, nor the first value of a shape."""
        plain = self.start if self.role == "shape" else None
        bounds = (b for b in (self.lower, self.upper) if b and b != plain)
        return any(isclose(value, b, rel_tol=1e-6) for b in bounds)


@dataclass(frozen=True)
class State:
    """A state of a system, or of an effect that brings its own (``per_axis`` then counts axes).

    ``like`` names a measured state whose values are a first guess for this hidden one; without it
    a fit and a simulation begin a system's state at ``start``, in its unit. Of an effect on a
    sensor or an input ``like`` may be ``position``: the state begins at what is there.
    """

    name: str
    unit: str
    per_axis: bool = False
    like: str = ""
    start: float = 0.0

    def __post_init__(self) -> None:
        _check_name("state", self.name)
        if self.like and self.start:
            raise PluginError(
                f"state {self.name!r} with like={self.like!r} and start={self.start:g}",
                "one of the two: what it begins like, or a number",
                "leave one out",
            )

    @property
    def first_guess(self) -> str:
        """Where it is declared to begin, in words after its kind; empty for zero."""
        if self.like:
            return f", begins like {self.like}"
        return f", begins at {self.start:g}" if self.start else ""


Interpolation = Literal[
    "smooth", "band_limited", "linear", "denoised",
    "zero_order", "zero_order_1", "zero_order_2", "zero_order_3",
]  # fmt: skip

Ways = Mapping[str, Interpolation]
"""Inputs by name, and how each runs between its samples."""

BETWEEN: dict[Interpolation, str] = {
    "smooth": "a cubic spline through the samples",
    "band_limited": "a band-limited signal through the samples",
    "linear": "straight lines through the samples",
    "denoised": "a cubic spline through the samples without their white noise",
    "zero_order": "held until the next sample",
    "zero_order_1": "held until the next sample, one sample late",
    "zero_order_2": "held until the next sample, two samples late",
    "zero_order_3": "held until the next sample, three samples late",
}
"""Each interpolation of an input between its samples, in words."""

HELD: dict[Interpolation, int] = {
    "zero_order": 0, "zero_order_1": 1, "zero_order_2": 2, "zero_order_3": 3,
}  # fmt: skip
"""Interpolations that hold a value until the next one, and how many samples late it acts."""


@dataclass(frozen=True)
class Input:
    """A known input, and how it is interpolated between samples.

    ``smooth`` is a cubic spline (speed, phase), ``band_limited`` a polyphase FIR interpolation
    (a measured force), ``linear`` straight lines, ``denoised`` a spline through samples that white
    noise was taken from (a measured voltage), ``zero_order`` holds each value until the next
    sample, ``zero_order_1`` from the next one on (a controller's command that acts in its next
    cycle; also ``_2`` and ``_3``). A record may say otherwise (``record.hold``); where none does,
    the default strategy takes the most likely of them. ``derived_from`` names another input that
    this one follows from where it is not measured (``phase`` from ``speed``). With ``derivative``
    its rate is known as ``NAME_rate``: that of a least-squares spline as smooth as the samples'
    noise asks for.
    """

    name: str
    unit: str
    interpolation: Interpolation = "smooth"
    derived_from: str | None = None
    derivative: bool = False

    def __post_init__(self) -> None:
        _check_name("input", self.name)

    @property
    def shape(self) -> str:
        """How it is interpolated, in words."""
        return BETWEEN[self.interpolation]

    @property
    def rate(self) -> State:
        """Its rate, as formulas call it, with its unit."""
        return State(f"{self.name}_rate", per_second(self.unit))
