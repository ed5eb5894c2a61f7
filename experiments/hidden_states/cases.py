"""Conditions under which hidden states are reconstructed: what is wrong, and by how much."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from spiral_plugins.observers.kalman import Ekf, Rts
from spiral_plugins.observers.paper import EkfPaper
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.engine.filter.observer import Observer
from spiral.engine.filter.stochastic import simulate_disturbed
from spiral.engine.filter.task import FilterInput, prepare_task, with_record
from spiral.inference.reconstruction.uncertain import declared_prior
from spiral.inference.simulate import with_defaults
from spiral.types.model import seed_model
from spiral.types.record import Record

PHASE = 1.3  # of the records here; the model was made for another mark on the shaft
RATE = 2000.0
SOFT_SPAN = 0.15
HONEST = {"observed": 0.1, "hidden": 0.1}

# Relative errors of alpha and beta, %: the paper's RMSE over its own matched one, times the
# relative errors of its table state_errors (1.4 and 1.6 %).
_PAPER_RMSE = {
    "noise 2 %": (2.9e-4, 2.8e-4), "noise 5 %": (7.0e-4, 6.8e-4), "noise 10 %": (1.3e-3, 1.3e-3),
    "noise 20 %": (2.4e-3, 2.3e-3), "joint 0 %": (2.9e-4, 2.8e-4), "joint 5 %": (3.5e-4, 3.6e-4),
    "joint 10 %": (4.6e-4, 5.0e-4), "joint 20 %": (7.0e-4, 7.6e-4),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One condition.

    ``joint``: every bearing parameter of the model times 1 + joint. ``independent``: each times
    1 +- independent with a sign of its own. ``drawn``: each of the true machine times 1 + drawn
    N(0, 1). ``declared``: the model's doubt of each, as a share of its value. ``phase_error``: of
    the model's phase origin, rad; ``tracked``: estimated as a state.
    ``kind``: ``coastdown``, ``soft`` (rotor_soft_tilt), or
    ``disturbed`` (a truth with real process noise, known to the filter).
    """

    name: str
    group: str
    noise: float = 0.02
    joint: float = 0.0
    independent: float = 0.0
    drawn: float = 0.0
    declared: float = 0.0
    phase_error: float = 0.0
    tracked: bool = False
    kind: str = "coastdown"
    observers: tuple[str, ...] = field(default=("ekf", "rts"))

    @property
    def paper(self) -> tuple[float, float] | None:
        """Relative errors of alpha and beta in the paper, where it has this condition."""
        found = _PAPER_RMSE.get(self.name)
        return (found[0] * 0.014 / 2.86e-4, found[1] * 0.016 / 2.80e-4) if found else None


CASES = (
    *(Case(f"noise {100 * n:.0f} %", "noise", noise=n) for n in (0.02, 0.05, 0.10, 0.20)),
    *(Case(f"joint {100 * d:.0f} %", "mismatch", joint=d) for d in (0.0, 0.05, 0.10, 0.20)),
    *(Case(f"independent {100 * d:.0f} %", "independent", independent=d)
      for d in (0.05, 0.10, 0.20)),
    *(Case(f"independent {100 * d:.0f} %, declared", "declared", independent=d, declared=d,
           observers=("rts",)) for d in (0.05, 0.10, 0.20)),
    *(Case(f"drawn {100 * d:.0f} %, declared", "declared", drawn=d, declared=d,
           observers=("rts",)) for d in (0.05, 0.10, 0.20)),
    Case("phase 0.01 rad off", "phase", phase_error=0.01),
    Case("phase 0.01 rad off, tracked", "phase", phase_error=0.01, tracked=True),
    Case("phase 2.5 rad off, tracked", "phase", phase_error=2.5, tracked=True),
    Case("real process noise", "honesty", kind="disturbed"),
    Case("soft tilt, matched", "soft", kind="soft"),
    Case("soft tilt, joint 5 %", "soft", kind="soft", joint=0.05),
    Case("soft tilt, drawn 5 %, declared", "declared", kind="soft", drawn=0.05, declared=0.05,
         observers=("rts",)),
    Case("settings of the paper", "paper", observers=("ekf_paper",)),
)  # fmt: skip


def record(case: Case, seed: int) -> Record:
    """The record of one seed, with its truth."""
    system = TiltingRotor()
    if case.kind != "soft" and not case.drawn:
        made = RotorCoastdown(seed=seed, noise_level=case.noise, rate=RATE, phase=PHASE)
        return made.load(system)[0]
    soft = {"system.span": SOFT_SPAN} if case.kind == "soft" else {}
    source = Simulation(
        system=system,
        values={"system.phase_origin": PHASE, **soft, **_machine(case, seed)},
        inputs={"speed": {"sweep": [40, 0], "unit": "Hz"}},
        duration=14.0,
        rate=RATE,
        seed=seed,
        noise_level=case.noise,
    )
    return source.load(system)[0]


def _machine(case: Case, seed: int) -> dict[str, float]:
    """Bearing parameters of the true machine, where they are drawn."""
    rng = np.random.default_rng([seed, 78])
    nominal = {k: v for k, v in TiltingRotor().defaults.items() if "@bearing" in k}
    return {k: v * (1.0 + case.drawn * rng.normal()) for k, v in nominal.items() if case.drawn}


@lru_cache(maxsize=2)
def _base(kind: str) -> FilterInput:
    """The true model, compiled once for a process."""
    system = TiltingRotor()
    values = {
        "system.phase_origin": PHASE,
        **({"system.span": SOFT_SPAN} if kind == "soft" else {}),
    }
    model = with_defaults(seed_model(system, values=values))
    return prepare_task(model, record(Case("first", "first", kind=kind), 0))


def task(case: Case, seed: int) -> FilterInput:
    """What the observer is given: the model, wrong where asked, and a start from N(truth, P0)."""
    base = _base("soft" if case.kind == "soft" else "coastdown")
    rng = np.random.default_rng([seed, 77])
    if case.kind == "disturbed":
        series = simulate_disturbed(base, HONEST, case.noise, rng)
    else:
        series = record(case, seed)
    wrong = {"system.phase_origin": PHASE + case.phase_error}
    for key, value in zip(base.keys, base.values, strict=True):
        if "@bearing" in key:
            sign = rng.choice((-1.0, 1.0))
            wrong[key] = value * (1.0 + case.joint) * (1.0 + sign * case.independent)
    given = with_record(base.with_values(wrong), series)
    truth = np.array([values[0] for values in series.truth.values()])
    if case.declared:
        given = replace(
            given, prior=declared_prior(given.model, given, {"bearing.*": case.declared})
        )
    return replace(given, start=truth + rng.normal(size=len(truth)) * given.spread)


def observer(case: Case, name: str) -> Observer:
    """An observer as the case asks for it; process noise tuned unless it is known."""
    if name == "ekf_paper":
        return EkfPaper()
    known = HONEST if case.kind == "disturbed" else None
    track = None if case.tracked else ()
    return {"ekf": Ekf, "rts": Rts}[name](process_noise=known, track=track)
