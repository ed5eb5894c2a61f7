"""The options of ``strategy=paper`` (gates, library, learner, sampling) and of ``innovation``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from spiral.inference.problem import Problem, Published, Sampling
from spiral.types.errors import ConfigError
from spiral.types.fields import by_name, construct, defaults_of

if TYPE_CHECKING:
    from spiral.engine.gate import Gate
    from spiral.io.overrides import Assignment
    from spiral.io.registry import Registry

GATES = (
    "ljung_box", "bonferroni_t", "correlation_cluster", "contribution", "kfold_majority",
    "partial_f", "validation_rollback",
)  # fmt: skip
"""The paper's own, in the order of its Algorithm 1: guard, Gate 1, refinements, Gate 2."""


INNOVATION_GATES = ("innovation", "validation_rollback")
"""Those of ``strategy=innovation``."""


def with_strategy(config: dict[str, Any], items: Iterable[Assignment]) -> None:
    """Another strategy than before has other usual gates."""
    for item in items:
        if item.path == ("strategy",) and item.value != config["strategy"]:
            config["strategy"], config["gate"] = item.value, None


def gate_fields(given: Any, registry: Registry, strategy: Any = "paper") -> dict[str, Any]:
    """``[a, b]``, ``a`` or ``{a: {field: value}}`` -> name -> all its fields; null: the usual ones.

    Raises
    ------
    ConfigError : not a list of gates, or an unknown name.
    """
    if given is None:
        given = list(INNOVATION_GATES if strategy == "innovation" else GATES)
    chosen = by_name(given, "gate", "gate=[bonferroni_t,partial_f]")
    return {
        name: {**defaults_of(registry.entry("gate", name).plugin), **fields}
        for name, fields in chosen.items()
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


def gate_chain(gates: Mapping[str, Any], registry: Registry) -> tuple[Gate, ...]:
    """Gates with their fields, in the order asked."""
    pairs = gates.items()
    return tuple(registry.make("gate", name, fields, f"gate.{name}") for name, fields in pairs)


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
    from spiral.types.library import terms_of

    chain = gate_chain(gates, registry)
    for gate in chain:
        if gate.likelihood:
            raise ConfigError(
                f"gate={gate.plugin_name()} with strategy=paper",
                "a gate that judges a regression on derivatives",
                f"strategy=innovation gate=[{gate.plugin_name()}]",
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
