"""What is said of parameters that a record cannot tell from others: held, or with large errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def groups_of(details: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    """What the seed's record cannot tell apart, of a round's details: effects, or parameters."""
    return tuple(tuple(g) for g in details.get("tied", {}).get("groups", ()))


def effects_tied(details: Mapping[str, Any]) -> bool:
    """Whether several effects are tied: a candidate may then look like a sum of them."""
    return any("." not in label for group in groups_of(details) for label in group)


def held_said(details: Mapping[str, Any]) -> str:
    """Which parameters were held and why, in words; empty where none was."""
    names = tuple(details.get("tied", {}).get("parameters", ()))
    if not names:
        return ""
    tied = "; ".join(" with ".join(g) for g in groups_of(details))
    keep = "keeps the value that it was" if len(names) == 1 else "keep the values that they were"
    return (
        f"The record cannot tell some of the model's own parameters apart ({tied}): "
        f"{', '.join(names)} {keep} given, to which other values are relative."
    )


def untold_said(details: Mapping[str, Any]) -> str:
    """Which parameters of a model to which effects were added have no values of their own."""
    untold = details.get("untold", {})
    if not untold:
        return ""
    names = untold["parameters"]
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    return f"Of {listed} the record tells only what they do together, beside what was added."
