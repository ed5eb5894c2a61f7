"""Conformance checks of learners, libraries and gates: each returns what it saw, or raises."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spiral.engine.gate import Gate, Surface, Trial
from spiral.engine.leastsquares import least_squares
from spiral.types.errors import ConfigError, PluginError
from spiral.types.learner import Learner, learned
from spiral.types.library import Library, terms_of
from spiral.types.record import Array
from spiral.types.system import System

_LEFT = 0.5  # share of a smooth function's energy that a learner may leave on held-out samples


def _example_surface() -> tuple[Array, Array, Array]:
    """A smooth function of two outputs, and which samples train."""
    rng = np.random.default_rng(0)
    xi = rng.normal(size=(600, 3)) * [1e-4, 1.0, 100.0]
    unit = xi / [1e-4, 1.0, 100.0]
    r = np.column_stack([np.tanh(unit[:, 0]), 1e3 * unit[:, 1]])
    return xi, r, rng.random(600) < 0.7


def check_learning(learner: Learner) -> str:
    """A smooth function of two outputs is followed on samples that were not trained on."""
    fit = learned(learner, *_example_surface(), 1)
    left = fit.log["validation_left"]
    if not left < _LEFT:
        raise PluginError(f"{left:.2g} of a smooth function is left", f"under {_LEFT:g}")
    return f"{left:.2g} of the energy is left"


def check_repeatable_learning(learner: Learner) -> str:
    """The same seed gives the same function."""
    xi, r, train = _example_surface()
    once, again = (learned(learner, xi, r, train, 1).predict(xi) for _ in range(2))
    if not np.array_equal(once, again):
        raise PluginError("two fits with one seed that differ", "the same function")
    return "same numbers"


def check_library_terms(library: Library, systems: Sequence[System]) -> str:
    """Terms for at least one system, each with units that fit its equation."""
    counts = {}
    for system in systems:
        try:
            counts[system.plugin_name()] = len(terms_of(library, system))
        except ConfigError:
            continue
    if not counts:
        raise PluginError("no term for any system", "terms for one")
    return ", ".join(f"{k}: {v} terms" for k, v in counts.items())


def trial() -> Trial:
    """Two equations with three candidates, of which the first is true."""
    rng = np.random.default_rng(0)
    active, columns = rng.normal(size=(400, 2, 1)), rng.normal(size=(400, 2, 3))
    target = 2.0 * active[..., 0] + columns[..., 0] + 0.1 * rng.normal(size=(400, 2))
    flat = columns.reshape(-1, 3)
    surface = Surface(least_squares(flat, columns[..., 0].reshape(-1)), 400, 1.0)
    train = np.arange(400) % 10 < 7
    bare = Trial(
        ("a", "b", "c"), (0, 1, 2), target, active, columns, target - 2.0 * active[..., 0],
        train, np.abs(active[:, 0, 0]), np.zeros(400, dtype=int), surface,
    )  # fmt: skip
    every = np.ones(400, dtype=bool)
    before = bare.fitted((), every).rss
    return replace(bare, gain=lambda kept: (before - bare.fitted(kept, every).rss) / 0.1**2)


def check_judgement(gate: Gate) -> str:
    """Of three candidates a strong true one passes, and nothing that was not asked."""
    asked = trial()
    judgement = gate.judge(asked)
    if not set(judgement.kept) <= set(asked.kept):
        raise PluginError(f"candidates {judgement.kept} of {asked.kept}", "some of those asked")
    if 0 not in judgement.kept and not gate.guard:
        raise PluginError("a strong true term that does not pass", "it passes")
    if not judgement.kept and not judgement.reason:
        raise PluginError("nothing kept without a reason", "a reason, for the loop ends with it")
    return f"{len(judgement.kept)} of 3 pass"


def check_gate_log(gate: Gate) -> str:
    """Its figures are plain data that JSON takes, and the same each time."""
    first, second = (gate.judge(trial()) for _ in range(2))
    try:
        text = json.dumps(dict(first.log))
    except (TypeError, ValueError) as error:
        raise PluginError(
            f"a log that JSON does not take: {error}", "numbers, text, lists"
        ) from error
    if text != json.dumps(dict(second.log)):
        raise PluginError("two judgements of one trial that differ", "the same figures")
    return f"{len(first.log)} figures"
