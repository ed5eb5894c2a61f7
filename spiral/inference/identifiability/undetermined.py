"""Sentences about parameters that a record cannot determine: held, or known in combination."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from spiral.types.formatting import number


def tied_groups(
    details: Mapping[str, Any], last: Mapping[str, Any] | None = None
) -> tuple[tuple[str, ...], ...]:
    """Groups of effects or parameters that the record cannot tell apart, from a round's details.

    ``last`` : those of a later round, which may hold none of them any more.
    """
    if last is not None and "tied" in details and not last.get("held"):
        return ()
    return tuple(tuple(g) for g in details.get("tied", {}).get("groups", ()))


def has_tied_effects(details: Mapping[str, Any]) -> bool:
    """Whether several effects are tied: a candidate may then look like a sum of them."""
    return are_effects_tied(tied_groups(details))


def are_effects_tied(groups: Iterable[Iterable[str]]) -> bool:
    """Whether groups that look alike hold whole effects, not only parameters of one owner."""
    return any("." not in label for group in groups for label in group)


def describe_held_parameters(
    details: Mapping[str, Any], last: Mapping[str, Any] | None = None
) -> str:
    """Which parameters were held and why, in words; empty where none was.

    ``last`` as in ``tied_groups``.
    """
    tied = details.get("tied", {})
    names, fitted = tuple(tied.get("parameters", ())), tied.get("fitted", {})
    if last is not None:
        names = tuple(k for k in names if k in last.get("held", ()))
        fitted = {k: v for k, v in fitted.items() if k in names}
    if not names:
        return ""
    groups = "; ".join(" with ".join(g) for g in tied_groups(details))
    given = [n for n in names if n not in fitted]
    said = []
    if given:
        keep = (
            "keeps the value that it was" if len(given) == 1 else "keep the values that they were"
        )
        other = "it" if len(given) == 1 else "them"
        said.append(f"{', '.join(given)} {keep} given; the other values are relative to {other}.")
    if fitted:
        chosen = " and ".join(f"{name} = {number(value)}" for name, value in fitted.items())
        was, is_one = ("was", "is one") if len(fitted) == 1 else ("were", "are some")
        said.append(
            f"{', '.join(fitted)} {was} not given: {chosen} {is_one} of many values that fit as "
            "well. Give what is known (values=), and the others follow."
        )
    return " ".join(
        [f"The record cannot tell some of the model's own parameters apart ({groups}).", *said]
    )


def describe_undetermined_parameters(details: Mapping[str, Any]) -> str:
    """Which parameters are determined only together once effects were added; empty for none."""
    untold = details.get("untold", {})
    if not untold:
        return ""
    names = untold["parameters"]
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    return f"With what was added, the record determines {listed} only in combination."
