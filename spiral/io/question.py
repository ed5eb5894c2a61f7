"""From a model, records and choices to a ``Problem``: the one place where a question is put.

The command line composes these arguments by Hydra (``spiral.io.config``), a program gives them as
they are (``spiral.api``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from spiral.inference.evidence.scales import with_scaled_shapes
from spiral.inference.problem import Problem, Settings
from spiral.io.paper_options import gate_chain, gate_fields, with_published
from spiral.io.registry import Registry
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.fields import defaults_of
from spiral.types.model import Model
from spiral.types.placement import check_effect
from spiral.types.record import Record, in_blocks, split_off_test

STRATEGIES = ("likelihood", "shooting", "innovation", "paper")
USUAL_STRATEGY = STRATEGIES[0]
MOST_BLOCKS = 50  # in which a share of a record is kept apart
USED_BY = {
    "gate": ("paper", "innovation"),
    "learner": ("paper",),
    "library": ("paper",),
    "paper": ("paper",),
    "derivative": ("paper",),
}
"""Sections of a configuration, and the strategies that use them."""
USUAL = {"derivative": "total_variation", "learner": "tanh_network", "library": "paper"}


def check_strategy(name: str) -> str:
    """The name of a strategy.

    Raises
    ------
    ConfigError : there is none of this name.
    """
    if name not in STRATEGIES:
        raise ConfigError(
            f"strategy={name}", f"one of {', '.join(STRATEGIES)}", did_you_mean(name, STRATEGIES)
        )
    return name


def check_used(section: str, strategy: str, given: str) -> None:
    """Refuse an option that a strategy does not use; ``given`` is how it was asked for.

    Raises
    ------
    ConfigError : it would be dropped in silence.
    """
    users = USED_BY.get(section, STRATEGIES)
    if strategy not in users:
        raise ConfigError(
            f"{given} with strategy={strategy}",
            f"an option of that strategy; {section} is one of {' and '.join(users)}",
            f"strategy={users[0]} {given}, or leave it out",
        )


def candidates_for(
    registry: Registry,
    model: Model,
    named: Sequence[str | Effect] | None,
    everywhere: bool = False,
) -> tuple[Effect, ...]:
    """Effects that may be missing: those named, or all that fit, less those of the model.

    Raises
    ------
    ConfigError : an effect that does not fit the system.
    """
    if named is None:
        found = registry.candidates(model.system, everywhere)
    else:
        found = tuple(
            registry.effect_from_label(e) if isinstance(e, str) else e for e in dict.fromkeys(named)
        )
        for effect in found:
            check_effect(model.system, effect)
    return tuple(e for e in found if e.label not in model.labels)


def check_holdout(share: float, blocks: int) -> None:
    """Refuse a share or a number of blocks that leaves too little to fit or to test."""
    if not 0.02 <= share <= 0.9:
        raise ConfigError(f"holdout={share:g}", "a share between 0.02 and 0.9")
    if not (isinstance(blocks, int) and 1 <= blocks <= MOST_BLOCKS):
        raise ConfigError(f"holdout_blocks={blocks}", f"a whole number from 1 to {MOST_BLOCKS}")


def check_settle(settle: float | None) -> None:
    """Refuse what is no time."""
    if settle is not None and not (isinstance(settle, int | float) and settle >= 0):
        raise ConfigError(f"test.settle={settle!r}", "seconds, zero or above")


def split(
    records: tuple[Record, ...], test: tuple[Record, ...] | None, holdout: float, blocks: int = 1
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Records to fit and to test; without a test the last share of each record is kept apart.

    In ``blocks`` it is the last share of each of so many equal stretches, each of which then has an
    initial state of its own: a run-down is tested at all its speeds.

    Raises
    ------
    ConfigError : a share or a number of blocks out of range.
    """
    check_holdout(holdout, blocks)
    if test is not None:
        return records, test
    pairs = [split_off_test(part, holdout) for r in records for part in in_blocks(r, blocks)]
    return tuple(f for f, _ in pairs), tuple(t for _, t in pairs)


def put(
    registry: Registry,
    model: Model,
    records: tuple[Record, ...],
    test: tuple[Record, ...] | None,
    *,
    holdout: float = 0.2,
    holdout_blocks: int = 1,
    settle: float | None = None,
    candidates: Sequence[str | Effect] | None = None,
    settings: Settings | None = None,
    strategy: str = USUAL_STRATEGY,
    parts: Mapping[str, Any] | None = None,
    gates: Mapping[str, Any] | None = None,
    paper: Mapping[str, Any] | None = None,
) -> Problem:
    """The question of a study.

    Parameters
    ----------
    records, test : to fit, and to judge by (``split``).
    settle : seconds of a test record that fix its own nuisances.
    candidates : labels or effects; left out, all that fit the system.
    parts, gates, paper : of ``strategy=paper``: plugins, gate -> fields, fields of ``Sampling``;
        of ``strategy=innovation``: gates.

    Raises
    ------
    ConfigError : an unknown strategy, a candidate that does not fit, a value out of range.
    """
    check_strategy(strategy)
    check_settle(settle)
    everywhere = strategy == "likelihood"
    asked = () if strategy == "paper" else candidates_for(registry, model, candidates, everywhere)
    fitted, kept = split(records, test, holdout, holdout_blocks)
    model, scaled = with_scaled_shapes(model, fitted)
    problem = Problem(model, fitted, kept, settle, asked, settings or Settings(), scaled=scaled)
    if strategy in ("shooting", "likelihood"):
        problem = replace(problem, dictionary=registry.dictionary(model.system))
        return replace(problem, likelihood=strategy == "likelihood")
    chosen = gates if gates is not None else gate_fields(None, registry, strategy)
    if strategy == "innovation":
        return replace(problem, innovation=gate_chain(chosen, registry))
    plugins = {
        kind: registry.make(kind, name, defaults_of(registry.entry(kind, name).plugin))
        for kind, name in USUAL.items()
        if kind not in (parts or {})
    }
    labels = None
    if candidates is not None:
        labels = tuple(c if isinstance(c, str) else c.label for c in candidates)
    return with_published(
        problem, {**plugins, **(parts or {})}, chosen, paper or {}, labels, registry
    )
