"""Sentences about parameters that a record cannot determine: held, or known in combination."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def tied_groups(details: Mapping[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Groups of effects or parameters that the record cannot tell apart, from a round's details."""
    return tuple(tuple(g) for g in details.get("tied", {}).get("groups", ()))


def has_tied_effects(details: Mapping[str, Any]) -> bool:
    """Whether several effects are tied: a candidate may then look like a sum of them."""
    return any("." not in label for group in tied_groups(details) for label in group)


def describe_held_parameters(details: Mapping[str, Any]) -> str:
    """Which parameters were held and why, in words; empty where none was."""
    names = tuple(details.get("tied", {}).get("parameters", ()))
    if not names:
        return ""
    tied = "; ".join(" with ".join(g) for g in tied_groups(details))
    keep = "keeps the value that it was" if len(names) == 1 else "keep the values that they were"
    return (
        f"The record cannot tell some of the model's own parameters apart ({tied}): "
        f"{', '.join(names)} {keep} given; the other values are relative to it."
    )


def describe_undetermined_parameters(details: Mapping[str, Any]) -> str:
    """Which parameters are determined only together once effects were added; empty for none."""
    untold = details.get("untold", {})
    if not untold:
        return ""
    names = untold["parameters"]
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    return f"With what was added, the record determines {listed} only in combination."
