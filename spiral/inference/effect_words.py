"""Words for the effects of a model: where they act, what they follow, what looks like them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from spiral.physics.formulas.laws import law_meaning
from spiral.types.effect import (
    Effect,
    ForceEffect,
    ParameterEffect,
    SensorEffect,
    is_other_value,
    is_path,
)
from spiral.types.formatting import first_words, join_words, number
from spiral.types.model import Model, pretty_unit
from spiral.types.placement import at_every_place
from spiral.types.port import Port, place_name, varied_key
from spiral.types.run import Round, untold_effects
from spiral.types.system import System


def name_effects(rounds: Sequence[Round], labels: Sequence[str], least_t: float) -> str:
    """Effects of the last model with their places and look-alikes, as words of a sentence.

    ``least_t`` : |estimate| over standard error from which an effect of sensors acts on one.
    """
    model = rounds[-1].comparison.model
    return ", ".join(
        _label_with_place(model, x, least_t) + _look_alikes_clause(model, rounds, x) for x in labels
    )


def _look_alikes_clause(model: Model, rounds: Sequence[Round], label: str) -> str:
    """An effect's look-alikes, in brackets; empty where there are none.

    The same effect at the first place of a system, whose label leaves that out, is named with it.
    """
    alike = untold_effects(rounds, label)
    if not alike:
        return ""
    ours = next((e for e in model.effects if e.label == label), None)
    first = None if ours is None else replace(ours, port="")
    names = [
        _effect_with_place(model.system, first) if first and first.label == x else x for x in alike
    ]
    return f" (or {first_words(names)}: this record cannot tell them apart)"


def followed_words(system: System, port: Port) -> str:
    """What a parameter follows at a port: a variable, or the sum that it multiplies."""
    _, words = system.arguments.get(port.against, ("", ""))
    return words or port.against


def _label_with_place(model: Model, label: str, least_t: float) -> str:
    """An effect of a model with its place, where its label leaves out that it is the first.

    Of a parameter that varies it is said what it follows, of a law what it is.
    """
    effect = next((e for e in model.effects if e.label == label), None)
    if is_other_value(effect):
        return f"{label} ({_other_value(model, effect)})"
    if isinstance(effect, ParameterEffect):
        port = model.system.place(effect)
        follows = followed_words(model.system, port)
        return f"{label} ({port.axes[0]} is no constant: it follows {follows})"
    if is_path(effect):
        port = model.system.place(effect)
        return f"{label} (on the way from {port.against} to {port.axes[0]})"
    if effect is None:
        return label
    law, axes = law_meaning(effect), _only_axes(model, effect, least_t)
    named = (
        f"{effect.label} at {join_words(axes)}" if axes
        else _effect_with_place(model.system, effect)
    )  # fmt: skip
    return f"{named} ({law})" if law else named


def _other_value(model: Model, effect: ParameterEffect) -> str:
    """Of a known parameter that is off: what it is, and what it was given as."""
    key = varied_key(model.system.place(effect))
    given, error = model.given_values[key], model.values.get(f"{effect.label}.error", 0.0)
    value = f"{number(given * (1 + error))} {pretty_unit(model.unit(key))}".strip()
    return f"{effect.port} is {value}, not {number(given)}"


def _only_axes(model: Model, effect: Effect, least_t: float) -> tuple[str, ...]:
    """The axes on which an effect of sensors surely acts, where it does not so on all."""
    axes = model.system.place(effect).axes
    if not isinstance(effect, SensorEffect) or len(axes) < 2:
        return ()
    values = model.estimates().get(effect.label, {})
    names = [q.name for q in effect.amplitudes() if q.per_axis]
    sizes = {a: [values[f"{n}_{a}"].t for n in names if f"{n}_{a}" in values] for a in axes}
    told = tuple(a for a in axes if any(abs(t or 0.0) >= least_t for t in sizes[a]))
    return told if len(told) < len(axes) else ()


def _effect_with_place(system: System, effect: Effect) -> str:
    """An effect's label, with its place where the label leaves out that it is the first."""
    if effect.port or len(at_every_place(system, effect)) < 2:
        return effect.label
    port = system.place(effect)
    name = port.name if isinstance(effect, ForceEffect) else place_name(port)
    return f"{effect.label} at {name}" if name else effect.label
