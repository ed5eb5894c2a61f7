"""Assembles the ``Problem`` of a study from a model, records and choices.

The command line composes these arguments by Hydra (``spiral.io.config``), a program gives them as
they are (``spiral.api``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from spiral.inference.evidence.scales import with_scaled_shapes
from spiral.inference.problem import Problem, Settings
from spiral.inference.strategies.base import Strategy
from spiral.io.registry import Registry
from spiral.types.effect import Effect, is_other_value
from spiral.types.errors import ConfigError
from spiral.types.model import Model
from spiral.types.placement import at_fitting_places, check_effect
from spiral.types.port import varied_key
from spiral.types.record import Record, check_fits, in_blocks, split_off_test

USUAL_STRATEGY = "likelihood"
MOST_BLOCKS = 50  # in which a share of a record is kept apart


def candidates_for(
    registry: Registry,
    model: Model,
    named: Sequence[str | Effect] | None,
    everywhere: bool = False,
) -> tuple[Effect, ...]:
    """Effects that may be missing: those named, or all that fit, less those of the model.

    ``everywhere`` : a name without a place is that effect at every place where it fits.

    Raises
    ------
    ConfigError : an effect that does not fit the system.
    """
    if named is None:
        effects = registry.candidates(model.system, everywhere)
    else:
        placed: dict[Effect, None] = {}
        for one in dict.fromkeys(named):
            effect = registry.effect_from_label(one) if isinstance(one, str) else one
            open_place = everywhere and isinstance(one, str) and not effect.port
            places = at_fitting_places(model.system, (effect,)) if open_place else ()
            if not places:
                check_effect(model.system, effect)
            placed |= dict.fromkeys(places or (effect,))
        effects = tuple(placed)
    return tuple(e for e in effects if e.label not in model.labels and not _is_of_freed(model, e))


def _is_of_freed(model: Model, effect: Effect) -> bool:
    """Whether an effect gives another value to a parameter that is found in any case."""
    return is_other_value(effect) and varied_key(model.system.place(effect)) in model.freed


def check_holdout(share: float | None, blocks: int) -> None:
    """Refuse a share or a number of blocks that leaves too little to fit or to test."""
    if share is not None and not 0.02 <= share <= 0.9:
        raise ConfigError(f"holdout={share:g}", "a share between 0.02 and 0.9", "holdout=0.2")
    if not (isinstance(blocks, int) and 1 <= blocks <= MOST_BLOCKS):
        raise ConfigError(f"holdout_blocks={blocks}", f"a whole number from 1 to {MOST_BLOCKS}")


def check_settle(settle: float | None) -> None:
    """Refuse a settling time that is not a number of seconds, zero or above."""
    if settle is not None and not (isinstance(settle, int | float) and settle >= 0):
        raise ConfigError(f"test.settle={settle!r}", "seconds, zero or above")


def split_records(
    records: tuple[Record, ...], test: tuple[Record, ...] | None, holdout: float | None,
    blocks: int = 1,
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:  # fmt: skip
    """Records to fit and to test; without a test the last share of each record is kept apart.

    A share that is left out is a fifth, or up to half where that hardly moves.

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


def pose_problem(
    registry: Registry,
    model: Model,
    records: tuple[Record, ...],
    test: tuple[Record, ...] | None,
    *,
    holdout: float | None = None,
    holdout_blocks: int = 1,
    settle: float | None = None,
    candidates: Sequence[str | Effect] | None = None,
    settings: Settings | None = None,
    strategy: Strategy | str = USUAL_STRATEGY,
) -> Problem:
    """The ``Problem`` of a study: records to fit and to test, candidates, settings, strategy.

    Parameters
    ----------
    records, test : to fit, and to judge by (``split_records``).
    settle : seconds of a test record that fix its own nuisances.
    candidates : labels or effects; left out, all that fit the system.
    strategy : a plugin, or the name of one with its usual options.

    Raises
    ------
    ConfigError : an unknown strategy, a candidate that does not fit, a value out of range.
    """
    check_settle(settle)
    chosen = registry.make("strategy", strategy) if isinstance(strategy, str) else strategy
    named = None
    candidates = (candidates,) if isinstance(candidates, str) else candidates
    if candidates is not None:
        named = tuple(c if isinstance(c, str) else c.label for c in candidates)
    asked = chosen.candidates(model, named)
    if asked is None:
        asked = candidates_for(registry, model, candidates, chosen.everywhere)
    fitted, kept = split_records(records, test, holdout, holdout_blocks)
    for record in (*fitted, *kept):
        check_fits(model.system, record)
    model, scaled = with_scaled_shapes(model, fitted)
    problem = Problem(
        model, fitted, kept, settle, asked, settings or Settings(), strategy=chosen, scaled=scaled
    )
    if not chosen.curves:
        return problem
    return replace(
        problem, dictionary=registry.dictionary(model.system), varying=registry.varying()
    )
