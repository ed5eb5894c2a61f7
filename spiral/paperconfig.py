"""The options of ``strategy=paper``: its list of gates, its library and learner, its sampling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from spiral.errors import ConfigError
from spiral.fields import construct, defaults_of
from spiral.problem import Problem, Published, Sampling

if TYPE_CHECKING:
    from spiral.registry import Registry

GATES = (
    "ljung_box", "bonferroni_t", "correlation_cluster", "contribution", "kfold_majority",
    "partial_f", "validation_rollback",
)  # fmt: skip
"""The paper's own, in the order of its Algorithm 1: guard, Gate 1, refinements, Gate 2."""


def gate_fields(given: Any, registry: Registry) -> dict[str, Any]:
    """``[a, b]``, ``a`` or ``{a: {field: value}}`` -> name -> all its fields; null: the paper's.

    Raises
    ------
    ConfigError : not a list of gates, or an unknown name.
    """
    if given is None:
        given = list(GATES)
    if isinstance(given, str):
        given = [given]
    if isinstance(given, list):
        given = {str(name): {} for name in given}
    if not isinstance(given, Mapping):
        raise ConfigError(f"gate={given!r}", "a list of gates", "gate=[bonferroni_t,partial_f]")
    return {
        str(name): {**defaults_of(registry.entry("gate", str(name)).plugin), **(fields or {})}
        for name, fields in given.items()
    }


def sampling(given: Mapping[str, Any]) -> Sampling:
    """How the paper's strategy splits and samples, checked.

    Raises
    ------
    ConfigError : a value out of its range.
    """
    found = construct(Sampling, given, "paper")
    if not 0.1 <= found.train <= 0.95:
        raise ConfigError(f"paper.train={found.train:g}", "a share between 0.1 and 0.95")
    if found.points < 1000:
        raise ConfigError(f"paper.points={found.points}", "at least 1000")
    if found.seed < 0:
        raise ConfigError(f"paper.seed={found.seed}", "zero or above")
    return found


def with_published(
    problem: Problem,
    parts: Mapping[str, Any],
    gates: Mapping[str, Any],
    options: Mapping[str, Any],
    named: tuple[str, ...] | None,
    registry: Registry,
) -> Problem:
    """The problem asked of the paper's evidence; its candidates are the library's effects.

    Parameters
    ----------
    parts : the plugins ``derivative``, ``learner`` and ``library``.
    gates : name -> fields, in order.
    options : the fields of ``Sampling``.
    named : labels that limit the library, or None.

    Raises
    ------
    ConfigError : no term of the library is left.
    """
    from spiral.library import terms_of

    chain = tuple(
        registry.make("gate", name, fields, f"gate.{name}") for name, fields in gates.items()
    )
    found = Published(**parts, gates=chain, sampling=sampling(options))
    system = problem.model.system
    effects = {t.effect.label: t.effect for t in terms_of(found.library, system)}
    offered = tuple(
        e
        for label, e in effects.items()
        if label not in problem.model.labels and (named is None or label in named)
    )
    if named is not None and not offered:
        raise ConfigError(
            f"candidates=[{', '.join(named)}] with library={found.library.plugin_name()}",
            f"effects of that library: {', '.join(effects)}",
            "another library, or candidates left out",
        )
    return replace(problem, candidates=offered, published=found)
