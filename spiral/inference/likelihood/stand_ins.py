"""Effects that together stand in for one that no candidate is."""

from __future__ import annotations

from collections.abc import Iterable

from spiral.inference.effect_words import followed_words
from spiral.types.effect import FlowEffect, ForceEffect, ParameterEffect, StateFlow
from spiral.types.formatting import join_words
from spiral.types.model import Model

_CAUSES = 2  # different variables that parameters follow, from which no one cause changes them
_LAWS = 3  # of one variable at one place from which they are parts of one


def several_causes_sentences(model: Model, given: Iterable[str]) -> tuple[str, ...]:
    """A sentence where found changes of parameters follow different variables, else none.

    One cause changes what it changes by itself (warmth a stiffness and a damping). Changes that
    follow one thing here and another there fit what is missing, and are not what it is. ``given`` :
    labels of effects that were in the model from the start.
    """
    ports = [
        model.system.place(e)
        for e in model.effects
        if isinstance(e, ParameterEffect) and not e.steady and e.label not in given
    ]
    if len({port.against for port in ports}) < _CAUSES:
        return ()
    follows = (f"{p.axes[0]} follows {followed_words(model.system, p)}" for p in ports)
    told = " and ".join(dict.fromkeys(follows))
    return (
        f"{told}: one cause would be one variable, and together they may stand in for a law that "
        "no candidate is",
    )


def one_law_sentences(model: Model, given: Iterable[str]) -> tuple[str, ...]:
    """A sentence for each place where several found effects are laws of one variable.

    A spring and a damper are two; a linear and a dry friction may be. Three laws of the level or
    the position at one place, or of the speed there, add up to one that has another form, as the
    terms of a series do. Constants are laws of nothing, and effects that were ``given`` no finds.
    """
    known = {*given}
    groups: dict[tuple[str, ...], list[str]] = {}
    for effect in model.effects:
        constant = all(p.unit == "force" for p in effect.parameters)
        if effect.label in known or effect.states or constant:
            continue
        if isinstance(effect, ForceEffect | FlowEffect | StateFlow):
            port = model.system.place(effect)
            place = (*port.axes, port.against, _variable(effect))
            if len(port.axes) == 1:
                groups.setdefault(place, []).append(effect.label)
    return tuple(
        f"{join_words(labels)} are laws of one variable at one place: together they may stand in "
        "for a law that no candidate is"
        for labels in groups.values()
        if len(labels) >= _LAWS
    )


def _variable(effect: ForceEffect | FlowEffect | StateFlow) -> str:
    """What a force or a flow at a place is a law of; of a force the units of its values tell."""
    if isinstance(effect, StateFlow) and (effect.driver or effect.rated):
        return effect.driver or "velocity"
    fast = any("velocity" in p.unit for p in effect.parameters)
    return "velocity" if fast else "position"
