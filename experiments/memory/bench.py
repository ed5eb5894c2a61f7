"""One study of a machine whose missing force has memory, or has none, with a blank catalog."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from experiments.memory.truth import RATE, simulated
from experiments.studies.pieces import Row
from spiral.io.registry import load_registry
from spiral.types.model import seed_model
from spiral.types.record import make_record
from spiral.types.run import Run

SAYS = "What is missing has memory"


def blank() -> list[str]:
    """Labels of all effects of the catalog that fit the machine and have no states of their own."""
    registry = load_registry(None)
    system = registry.make("system", "oscillator")
    present = seed_model(system).labels
    found = registry.candidates(system, everywhere=True)
    return [e.label for e in found if not e.states and e.label not in present]


def asked(kind: str, noise: float, seed: int, candidates: Sequence[str]) -> Run:
    """What is said of a machine of which these are the candidates."""
    import spiral

    system = load_registry(None).make("system", "oscillator")
    found = simulated(kind, noise, seed)
    record, test = (
        make_record(system, name, np.arange(len(y)) / RATE, {"x": y}, {"force": u})
        for name, y, u in zip(("record", "test"), found.reading, found.force, strict=True)
    )
    return spiral.discover(record, system, test=test, candidates=candidates)


def study(kind: str, noise: float, seed: int) -> Row:
    """One study with a catalog that has no effect with memory."""
    run = asked(kind, noise, seed, blank())
    memory = run.memory or {}
    return {
        "verdict": run.verdict,
        "says": SAYS in run.summary, "missing": list(run.missing),
        "admitted": [x for r in run.rounds for x in r.admitted], "summary": run.summary,
        **{k: memory.get(k) for k in ("size", "share", "log_ratio", "p_value")},
        "told": memory.get("kind"),
    }  # fmt: skip
