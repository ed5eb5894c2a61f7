"""One question to ``spiral.discover``, and what is known of its answer."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from experiments.studies.outcomes import Row, coefficient, inside, named, told
from spiral.types.model import Model, seed_model
from spiral.types.record import Record
from spiral.types.system import System


@dataclass(frozen=True)
class Question:
    """Records, a system and the choices of a user; beside them what the truth is.

    ``choices`` go to ``spiral.discover`` as they are. ``hidden`` are the labels of which one is
    right, ``truth`` true values by full name, ``also`` labels that are no invention. ``floor`` is
    the relative error that the sensors alone make on the test record.
    """

    system: System
    records: tuple[Record, ...]
    test: tuple[Record, ...]
    choices: Mapping[str, Any] = field(default_factory=dict)
    hidden: tuple[str, ...] = ()
    truth: Mapping[str, float] = field(default_factory=dict)
    also: tuple[str, ...] = ()
    floor: float | None = None

    def asked(self, strategy: str | None = None, **more: Any) -> Row:
        """Discover, and what came of it; ``seconds`` are of one processor."""
        import spiral

        given = {**self.choices, **more}
        if strategy is not None:
            given["strategy"] = strategy
        clock = time.process_time()
        run = spiral.discover(self.records, self.system, test=self.test, **given)
        seconds = time.process_time() - clock
        own = {k: v for k, v in self.truth.items() if k.rsplit(".", 1)[0] in self.hidden}
        return {
            "hidden": list(self.hidden),
            "true_floor": self.floor,
            **told(run),
            **named(run, self.hidden, self.also),
            **coefficient(run, own),
            "inside": inside(run, {k: v for k, v in self.truth.items() if k not in own}),
            "seconds": seconds,
        }


def misjudged(
    model: Model, rng: np.random.Generator, least: float = 0.05, most: float = 0.2
) -> dict[str, float]:
    """Nominal values of what a fit moves, each wrong by 5 to 20 % to one side or the other."""
    found = {}
    for key in model.active:
        if dict(model.pairs)[key].scope == "record" or not model.values.get(key):
            continue
        side = rng.choice([-1.0, 1.0]) * rng.uniform(least, most)
        found[key] = model.values[key] * (1.0 + side)
    return found


def model_of(system: System, values: Mapping[str, float], free: Sequence[str]) -> Model:
    """The seed with its true values, where it has them."""
    model = seed_model(system)
    known = {k for k, _ in model.pairs}
    return Model(
        system,
        model.effects,
        {k: v for k, v in values.items() if k in known},
        freed=tuple(free),
    )
