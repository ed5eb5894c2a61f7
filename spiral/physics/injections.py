"""What effects add to the rates of a system, traced: forces and flows at their places."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import sympy as sp

from spiral.physics.plugin_calls import call_equation
from spiral.types.effect import (
    Effect,
    FlowEffect,
    ForceEffect,
    StateFlow,
    is_path,
)
from spiral.types.errors import PluginError, did_you_mean
from spiral.types.port import At, Port
from spiral.types.system import System, has_coordinates


@dataclass(frozen=True)
class PlacedEffect:
    """An effect at its port with the symbols it sees."""

    effect: Effect
    port: Port
    at: At
    p: SimpleNamespace
    jacobian: sp.Matrix | None


def system_rates(
    system: System, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace,
    injected: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """The rates of the system's states; an error where one is missing."""
    rates = call_equation(system, "rate", system.rate, x, u, p, injected)
    lost = [s.name for s in system.states if s.name not in rates]
    if lost:
        raise PluginError(
            f"rate of system {system.plugin_name()!r} without {', '.join(map(repr, lost))}",
            f"a rate for each state: {', '.join(s.name for s in system.states)}",
            "add it to what rate returns",
        )
    return rates


def with_rates_of_states(
    system: System, placed: list[PlacedEffect], seen: list[SimpleNamespace], x: SimpleNamespace,
    u: SimpleNamespace, p: SimpleNamespace,
) -> list[PlacedEffect]:  # fmt: skip
    """Flows that are ``rated`` see the rates that system and seed give their states.

    Those along a ``path`` see what they give a state where its driver has another value.
    """
    rated = [i for i in placed if isinstance(i.effect, StateFlow) and i.effect.rated]
    if not rated and not any(is_path(i.effect) for i in placed):
        return placed
    own = [(i, v) for i, v in zip(placed, seen, strict=True) if i.effect in system.seed]
    pushed = sum_injections(system, [i for i, _ in own], [v for _, v in own], x)
    rates = system_rates(system, x, u, p, pushed)
    entered = dict.fromkeys(i.port.axes[0] for i in placed if is_path(i.effect))
    more = {into: sp.Symbol(f"pushed_{into}", real=True) for into in entered}
    raised = rates
    if more:
        raised = system_rates(
            system, x, u, p, {**pushed, **{n: pushed[n] + m for n, m in more.items()}}
        )

    def with_rates(item: PlacedEffect) -> PlacedEffect:
        velocity = tuple(sp.sympify(rates[name]) for name in item.port.axes)
        return replace(item, at=replace(item.at, velocity=velocity))

    def with_path(item: PlacedEffect) -> PlacedEffect:
        (into,), (driver,) = item.port.axes, item.at.position
        row = state_entered(system, into)
        alone = sp.sympify(raised[row]).xreplace(
            {m: sp.S.Zero for n, m in more.items() if n != into}
        )
        gain, rate = sp.diff(alone, more[into]), sp.sympify(rates[row])

        def along_path(value: Any) -> Any:
            return (rate.xreplace({driver: sp.sympify(value)}) - rate) / gain

        return replace(item, at=replace(item.at, along_path=along_path))

    placed = [with_rates(i) if i in rated else i for i in placed]
    return [with_path(i) if is_path(i.effect) else i for i in placed]


def state_entered(system: System, injection: str) -> str:
    """The state whose rate an injection enters: a force that of its coordinate's rate."""
    forces = {c.name for c in system.coordinates} if has_coordinates(system) else set()
    return system.rate_name(injection) if injection in forces else injection


def sum_injections(
    system: System, placed: list[PlacedEffect], seen: list[SimpleNamespace], x: SimpleNamespace
) -> dict[str, Any]:
    """What all effects that are forces or flows add, by injection."""
    total: dict[str, Any] = {i.name: sp.Integer(0) for i in system.injections}
    for item, u in zip(placed, seen, strict=True):
        effect = item.effect
        if isinstance(effect, ForceEffect):
            force = call_equation(effect, "force", effect.force, item.at, u, item.p)
            _check_length(effect, "force", force, item.port)
            assert item.jacobian is not None
            coordinates = list(total)[: item.jacobian.cols]  # flows into other states come after
            for j, name in enumerate(coordinates):  # J^T F; most of J is zero or one
                pairs = zip(item.jacobian.col(j), force, strict=True)
                total[name] += sum(slope * value for slope, value in pairs if slope)
        elif isinstance(effect, StateFlow):
            flows = call_equation(effect, "flow", effect.flow, item.at, u, item.p)
            _check_length(effect, "flow", flows, item.port)
            for name, value in zip(item.port.axes, flows, strict=True):
                total[name] += value
        elif isinstance(effect, FlowEffect):
            levels = _states_with_own(x, item.at)
            for name, value in call_equation(
                effect, "flow", effect.flow, levels, u, item.p
            ).items():
                if name not in total:
                    raise PluginError(
                        f"effect {effect.label!r} with a flow into {name!r}",
                        f"one of the channels {', '.join(total)}",
                        did_you_mean(name, total),
                    )
                total[name] += value
    return total


def _states_with_own(x: SimpleNamespace, at: At) -> SimpleNamespace:
    """The system's states as a flow sees them: with the effect's own under ``own``."""
    return SimpleNamespace(**vars(x), own=at.own)


def _check_length(effect: Effect, what: str, values: list[Any], port: Port) -> None:
    if len(values) != len(port.axes):
        raise PluginError(
            f"{what} of effect {effect.label!r} with {len(values)} values",
            f"{len(port.axes)} values, one for each axis of port {port.name!r}",
        )
