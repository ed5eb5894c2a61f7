"""Effects: one physical mechanism each."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, TypeGuard

from spiral.types.label import make_label
from spiral.types.parameter import Parameter, State
from spiral.types.plugin import Plugin
from spiral.types.port import At, Port


class Effect(Plugin):
    """One physical mechanism with a name, a one-line meaning and parameters.

    Class attributes
    ----------------
    parameters : its numbers, with units relative to the port.
    states : states of its own (a lag, a hidden mode); their rates come from ``rate``.
    axes : how many axes its port must have; ``None`` takes any number.
    inputs : inputs it reads from ``u`` (``speed``, ``phase``).
    channels : states that the system must have, by name; none where any system will do.
    leaves : names of effects that its terms beyond leading order look like where it acts through
        hidden coordinates: found beside it, they are its own next order.
    special : names of effects that it becomes in the limits of its shape parameters. They are tried
        wherever it is: where both explain a record, the simpler one is the answer.
    twins : names of effects elsewhere (an input that acts late, beside a sensor that does) which do
        the same to what is measured; two formulas for it may differ by more than the noise.
    whole : amplitude -> its value where the effect fully is what its name says: a number, or the
        name of a shape that it equals (a lag whose time is that of its own state).
    bare : a monomial of a library without a physical name; no candidate unless it is asked for.

    Fields
    ------
    port : where it acts; empty means the system's first port.
    variant : tells copies of one effect apart inside a study (a grid of shapes); not for users.
    """

    kind: ClassVar[str] = "effect"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    states: ClassVar[tuple[State, ...]] = ()
    axes: ClassVar[int | None] = None
    inputs: ClassVar[tuple[str, ...]] = ()
    channels: ClassVar[tuple[str, ...]] = ()
    leaves: ClassVar[tuple[str, ...]] = ()
    special: ClassVar[tuple[str, ...]] = ()
    twins: ClassVar[tuple[str, ...]] = ()
    whole: ClassVar[Mapping[str, float | str]] = {}
    bare: ClassVar[bool] = False

    port: str = ""
    variant: str = ""

    @property
    def label(self) -> str:
        """Its name in a model: ``cubic_stiffness`` or ``cubic_stiffness@bearing_2``."""
        return make_label(self.plugin_name(), self.port, self.variant)

    @classmethod
    def amplitudes(cls) -> tuple[Parameter, ...]:
        """Parameters that are zero when the effect is absent."""
        return tuple(p for p in cls.parameters if p.role == "amplitude")

    @classmethod
    def undirected(cls) -> bool:
        """Whether it turns with the phase but has no direction of its own (an unbalance)."""
        return "phase" in cls.inputs and len(cls.amplitudes()) == 1

    def rate(self, at: At, u: SimpleNamespace, p: SimpleNamespace) -> dict[str, Any]:
        """Time derivatives of its own states: name -> value, or list of values per axis."""
        return {}

    def remark(self, values: Mapping[str, float], step: float) -> str:
        """A sentence on what fitted values (by parameter name) imply; empty for most effects.

        ``step`` is the time between samples in s.
        """
        return ""

    def limit_values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Values that its ``special`` cases and twins begin with, where they are called otherwise.

        ``values`` and the answer are by parameter name.
        """
        return {}

    def contradiction(self, fitted: Mapping[str, float]) -> str:
        """Why values that a record determines make it another effect; empty for most effects.

        ``fitted`` holds, by parameter name, what was fitted and has a standard error.
        """
        return ""

    def keys(self, port: Port) -> tuple[tuple[str, Parameter], ...]:
        """(full parameter name, parameter) in order, per axis where the parameter is."""
        return expand(self.label, self.parameters, port.axes)


class ForceEffect(Effect):
    """A force at a port, one component per axis, in the port's unit of force.

    ``pairs`` : whether it also acts between any two coordinates of one unit (``System.links``),
    which need not be the axes of a plane; it is offered where they may be (``System.planes``).
    """

    pairs: ClassVar[bool] = False

    @abstractmethod
    def force(self, at: At, u: SimpleNamespace, p: SimpleNamespace) -> list[Any]:
        """The force on the machine, one value per axis of the port."""


class SensorEffect(Effect):
    """A change of what a sensor reports; the motion stays as it is.

    One whose ``driver`` is ``"any"`` follows an input or a state that is not what the sensor
    reports, nor its rate: its port is the channel and the driver, ``CHANNEL-VARIABLE``;
    ``position`` is the driver and its unit, ``force`` the channel's unit.
    """

    driver: ClassVar[Literal["", "any"]] = ""

    @abstractmethod
    def reading(self, y: list[Any], at: At, u: SimpleNamespace, p: SimpleNamespace) -> list[Any]:
        """The readings of the port's axes, from the readings ``y`` without this effect."""


class InputEffect(Effect):
    """A change of an input by its actuator: the input that acts differs from the recorded one.

    Its port is an input, the first that may be changed where none is named: one that no other
    input follows from. ``position`` is the unit of that input. One that ``shifts`` adds a constant:
    it is tried where that does more than a constant flow or force at one place, which else says so.
    """

    shifts: ClassVar[bool] = False

    @abstractmethod
    def drive(self, at: At, u: SimpleNamespace, p: SimpleNamespace) -> Any:
        """The input that acts, from the recorded one, ``at.position[0]``."""


class StateFlow(Effect):
    """A flow into any state of first order (a level, a temperature, a charge), or between two.

    Its port is that state, or a pair of one unit, ``NAME-NAME``: the first that fits where none is
    named. ``force`` is the unit of what flows in, ``position`` that of the state. ``axes`` is 1
    for one state, 2 for a pair; ``units`` are those of the states that it is about, empty for any.
    One of ``differences`` also acts on what a state has more than an input of its unit, or than a
    state with which a third one balances it, at ``NAME-OTHER``: a loss to surroundings that were
    measured, the drag of what flows into a tank; ``"only"`` there. One whose ``driver`` is an
    ``"input"`` (or a ``"state"`` of another unit) acts where the system gives that no path: its
    port is what it acts on, a coordinate too, and its driver, ``NAME-INPUT``; ``position`` is the
    driver and its unit. A ``"path"`` is one that the system does give a state to another: there
    ``at.along_path(z)`` is the change of what flows in where the driver is replaced by z.
    One that is ``rated`` sees as ``at.velocity`` the rates that the system and its seed give the
    states of its port.
    """

    axes: ClassVar[int | None] = 1
    rated: ClassVar[bool] = False
    units: ClassVar[tuple[str, ...]] = ()
    differences: ClassVar[bool | Literal["only"]] = False
    driver: ClassVar[Literal["", "input", "state", "path"]] = ""

    @abstractmethod
    def flow(self, at: At, u: SimpleNamespace, p: SimpleNamespace) -> list[Any]:
        """What flows into each state of the port, ``at.position`` being their values."""


class ParameterEffect(Effect):
    """A parameter of the model that is no constant: it follows a state, an input or time.

    The value that acts is ``factor`` times the parameter's own. Its port is that parameter and what
    it follows, ``PARAMETER-VARIABLE`` (``conductance-flow``, ``linear_stiffness.stiffness-time``).
    ``position`` is the unit of what it follows, ``units`` those that it may have, empty for any. It
    has no states of its own. One that is ``steady`` follows nothing: a known parameter has another
    value; its port is that parameter. ``periodic`` : it repeats, so that no smooth change shows it.
    """

    axes: ClassVar[int | None] = 1
    units: ClassVar[tuple[str, ...]] = ()
    steady: ClassVar[bool] = False
    periodic: ClassVar[bool] = False

    @abstractmethod
    def factor(self, at: At, u: SimpleNamespace, p: SimpleNamespace) -> Any:
        """The factor, 1 where all amplitudes are zero; ``at.position[0]`` is what it follows."""


def is_other_value(effect: object) -> TypeGuard[ParameterEffect]:
    """Whether an effect is that a known parameter has another value than was given."""
    return isinstance(effect, ParameterEffect) and effect.steady


def is_plain_change(effect: object) -> TypeGuard[ParameterEffect]:
    """Whether an effect is a parameter's change without shapes to be searched: a line, a power."""
    if not isinstance(effect, ParameterEffect) or effect.steady or effect.bare:
        return False
    return all(len(p.grid) <= 1 for p in effect.parameters)


def is_periodic_change(effect: object) -> TypeGuard[ParameterEffect]:
    """Whether an effect is a parameter's change that repeats."""
    return isinstance(effect, ParameterEffect) and effect.periodic


def is_path(effect: object) -> TypeGuard[StateFlow]:
    """Whether an effect changes how a state acts on another."""
    return isinstance(effect, StateFlow) and effect.driver == "path"


class FlowEffect(Effect):
    """A flow into named channels of a first-order system (a tank, a volume)."""

    @abstractmethod
    def flow(self, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace) -> dict[str, Any]:
        """Channel name -> flow into it; states of the effect's own are ``x.own``."""


def expand(
    owner: str, parameters: tuple[Parameter, ...], axes: tuple[str, ...]
) -> tuple[tuple[str, Parameter], ...]:
    """Full names ``owner.parameter``, with ``_axis`` where a parameter is per axis of several."""
    pairs = []
    for parameter in parameters:
        if parameter.per_axis and len(axes) > 1:
            pairs += [(f"{owner}.{parameter.name}_{axis}", parameter) for axis in axes]
        else:
            pairs.append((f"{owner}.{parameter.name}", parameter))
    return tuple(pairs)


def values_for(effect: Effect, axes: tuple[str, ...], values: Mapping[str, Any]) -> SimpleNamespace:
    """An effect's parameters as its equations see them, from values by full name."""
    p = SimpleNamespace()
    for parameter in effect.parameters:
        axis_values = [values[k] for k, _ in expand(effect.label, (parameter,), axes)]
        one = tuple(axis_values) if parameter.per_axis else axis_values[0]
        setattr(p, parameter.name, one)
    return p
