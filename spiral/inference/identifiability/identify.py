"""Before any fit: whether a record, or a planned test, can tell the terms of a library apart.

The paper's identifiability theory (Theorem 1, its propositions and corollaries) on the signatures
of the model's own terms and of all candidates. Of measurements the states are estimated by a
derivative estimator; a simulated record is a planned test, and its true states are taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from spiral.inference.identifiability.richness import (
    Richness,
    alias_groups,
    bias_bound,
    richness,
    samples_needed,
    snr_min,
    spread_bound,
)
from spiral.inference.identifiability.signatures import Signatures, equation_rows, signatures
from spiral.inference.problem import Problem, Progress, Settings, silent
from spiral.types.derivative import Derivative, Derivatives, differentiate
from spiral.types.display import Readable, Summary
from spiral.types.errors import ConfigError
from spiral.types.formatting import number
from spiral.types.model import Model
from spiral.types.record import Array, Record

_STANDS_OUT = 3.0  # noise standard deviations by which an unseen direction would have to show
_STEADY = 0.02  # relative variation of speed under which it counts as constant
_SETTLED = 4  # samples left out at each end of a planned test, where slopes are one-sided


@dataclass(frozen=True, repr=False)
class Identification(Readable):
    """The result of ``identify``: what a record can determine, before any fit.

    Parameters
    ----------
    verdict : whether the terms can be told apart.
    terms : the columns by full name.
    richness : rank, mu, condition and the Gram matrix.
    aliases : groups of effects that the record cannot tell apart.
    noise, acceleration : rms of the noise in the target and of the target, in its unit.
    epsilon : eps_0, the share of the target that the terms leave beyond noise.
    settings : levels that the needed samples are for.
    left_out : effect -> why it has no column.
    planned : whether true states of a simulation were taken.
    advice : what to do.
    """

    verdict: Literal["identifiable", "not_identifiable"]
    terms: tuple[str, ...]
    richness: Richness
    aliases: tuple[tuple[str, ...], ...]
    noise: float
    acceleration: float
    epsilon: float
    settings: Settings
    left_out: Mapping[str, str]
    planned: bool
    advice: str

    def _shown(self) -> Summary:
        needed = number(self.samples_needed) if np.isfinite(self.samples_needed) else "no number"
        rank = f"{self.richness.rank} of {len(self.terms)}"
        return Summary(
            f"{self.verdict}: {len(self.terms)} terms",
            ("rank", "condition", "mu", "samples needed", "cannot be told apart"),
            ((rank, number(self.richness.condition, 3), number(self.mu, 3), needed,
              "; ".join(", ".join(group) for group in self.aliases) or "-"),),
            self.advice,
        )  # fmt: skip

    @property
    def mu(self) -> float:
        """The Gram matrix's smallest eigenvalue; 0 where a direction is unseen."""
        return self.richness.mu if self.verdict == "identifiable" else 0.0

    @property
    def samples_needed(self) -> float:
        """Eq. (Nmin) for the smallest term of interest; infinite where a direction is unseen."""
        s, p = self.settings, self.richness.columns
        return samples_needed(self.mu, p, self.noise / self.acceleration, s.share, s.level, s.miss)

    @property
    def snr_min(self) -> float:
        """Eq. (SNR_min)."""
        p, n = self.richness.columns, self.richness.samples
        return snr_min(self.mu, p, n, self.epsilon, self.settings.level)

    @property
    def bias_bound(self) -> float:
        """Theorem 1's bias, as a share of the target's rms."""
        return bias_bound(self.mu, self.epsilon)

    @property
    def spread_bound(self) -> float:
        """Theorem 1's standard deviation, as a share of the target's rms."""
        p, n = self.richness.columns, self.richness.samples
        return spread_bound(self.mu, p, n, self.noise / self.acceleration)

    @property
    def snr(self) -> float:
        """Target over noise, rms over rms."""
        return self.acceleration / self.noise if self.noise > 0 else float("inf")

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        excitation = self.richness
        return {
            "verdict": self.verdict,
            "rank": excitation.rank,
            "columns": excitation.columns,
            "mu": excitation.mu,
            "coherence": excitation.coherence,
            "condition": excitation.condition,
            "aliases": [list(g) for g in self.aliases],
            "samples": excitation.samples,
            "samples_needed": self.samples_needed,
            "snr": self.snr,
            "snr_min": self.snr_min,
            "epsilon_0": self.epsilon,
            "bias_bound": self.bias_bound,
            "variance_bound": self.spread_bound,
            "terms": list(self.terms),
            "gram": excitation.gram.tolist(),
            "left_out": dict(self.left_out),
            "planned": self.planned,
            "advice": self.advice,
        }


@dataclass(frozen=True)
class _Motion:
    """States and target along one record, and the same with noise once more where measured."""

    record: Record
    states: Mapping[str, Array]
    target: Array
    disturbed: Mapping[str, Array] | None
    noise: float
    cut: slice


def identify(
    problem: Problem, derivative: Derivative, progress: Progress = silent
) -> Identification:
    """Judge the model's terms and all candidates by their signatures along the records.

    The system's own parameters that are known, as a mass, need not be told apart from anything.
    A direction of coefficients counts as seen where the singular value of its unit signature,
    less what noise in the states makes of it, is above 1e-3 and would show in the target by three
    standard deviations of its noise.

    Raises
    ------
    InputError : the equations need states that are not measured.
    ConfigError : no term acts anywhere.
    """
    model = problem.model
    motions = []
    for record in problem.records:
        progress(f"signatures along {record.name}")
        motions.append(_motion_along(model, record, derivative))
    made = [signatures(model, problem.candidates, m.states, m.record) for m in motions]
    keys = tuple(k for k in made[0].keys if all(k in other.keys for other in made))
    phi = _stack_signatures(made, keys, motions)
    again = _disturbed_signatures(problem, motions, keys)
    target = np.concatenate([m.target[:, m.cut].ravel() for m in motions])
    size = float(np.sqrt(np.mean(target**2)))
    noise = float(np.sqrt(np.mean([m.noise**2 for m in motions])))
    asked = [i for i, key in enumerate(keys) if not _is_known(model, key)]
    unseen = _STANDS_OUT * noise / (np.sqrt(len(target)) * size)
    excitation = richness(phi[:, asked], None if again is None else again[:, asked], unseen)
    terms = tuple(keys[i] for i in asked)
    aliases = alias_groups(excitation, made[0].only(terms).owners)
    identified = excitation.rank == excitation.columns
    return Identification(
        verdict="identifiable" if identified else "not_identifiable",
        terms=terms,
        richness=excitation,
        aliases=aliases,
        noise=noise,
        acceleration=size,
        epsilon=_mismatch(phi, target, 0.0 if again is None else noise),
        settings=problem.settings,
        left_out=made[0].left_out,
        planned=again is None,
        advice=_advice(problem, identified, aliases),
    )


def _is_known(model: Model, key: str) -> bool:
    """Whether a parameter of the system itself is known; one of each record never is."""
    if not key.startswith("system.") or key in model.active:
        return False
    return dict(model.pairs)[key].scope == "machine"


def _disturbed_signatures(
    problem: Problem, motions: list[_Motion], keys: tuple[str, ...]
) -> Array | None:
    """The signatures at states disturbed by noise once more; none where states are true ones."""
    disturbed = [(m.disturbed, m.record) for m in motions if m.disturbed is not None]
    if len(disturbed) < len(motions):
        return None
    moved = [signatures(problem.model, problem.candidates, d, r) for d, r in disturbed]
    return _stack_signatures(moved, keys, motions)


def _stack_signatures(
    made: list[Signatures], keys: tuple[str, ...], motions: list[_Motion]
) -> Array:
    """(rows, p): all equations of all records below one another, ends left out."""
    parts = [
        s.only(keys).columns[:, m.cut, :].reshape(-1, len(keys))
        for s, m in zip(made, motions, strict=True)
    ]
    return np.concatenate(parts)


def _motion_along(model: Model, record: Record, derivative: Derivative) -> _Motion:
    """True states of a simulated record, else estimated ones."""
    rows = equation_rows(model.system)
    if all(n in record.truth for n in (*model.system.observed, *rows)):
        target = np.array([np.gradient(record.truth[r], record.dt, edge_order=2) for r in rows])
        noise = _planned_noise(record, derivative, model)
        cut = slice(_SETTLED, record.samples - _SETTLED)
        return _Motion(record, record.truth, target, None, noise, cut)
    y = np.column_stack([record.channels[c] for c in model.system.observed])
    once = differentiate(derivative, y, record.dt, record.inputs.get("speed"))
    twice = differentiate(
        derivative, y + _draw_noise(record), record.dt, record.inputs.get("speed")
    )
    target, moved = _target_rates(model, once), _target_rates(model, twice)
    noise = float(np.sqrt(np.mean((moved - target)[:, once.inner] ** 2)))
    return _Motion(
        record,
        _state_estimates(model, once),
        target,
        _state_estimates(model, twice),
        noise,
        once.inner,
    )


def _draw_noise(record: Record) -> Array:
    """(N, C) noise of the record's own size."""
    sigma = np.array(list(record.sigma().values()))
    return np.random.default_rng(0).normal(size=(record.samples, len(sigma))) * sigma


def _state_estimates(model: Model, derivatives: Derivatives) -> dict[str, Array]:
    """Measured channels, and their velocities where the system has them."""
    rows = equation_rows(model.system)
    rates = dict(zip(rows, derivatives.velocity.T, strict=True))
    return {**rates, **dict(zip(model.system.observed, derivatives.position.T, strict=True))}


def _target_rates(model: Model, derivatives: Derivatives) -> Array:
    """(n, N): accelerations, or rates of a channel that is a state of first order."""
    names = zip(model.system.observed, equation_rows(model.system), strict=True)
    return np.array(
        [
            (derivatives.velocity if name == row else derivatives.acceleration)[:, i]
            for i, (name, row) in enumerate(names)
        ]
    )


def _planned_noise(record: Record, derivative: Derivative, model: Model) -> float:
    """rms of the noise that the estimator would leave in the target of a planned test."""
    if not any(record.noise.values()):
        return 0.0
    clean = np.column_stack([record.truth[c] for c in model.system.observed])
    speed = record.inputs.get("speed")
    once = differentiate(derivative, clean, record.dt, speed)
    twice = differentiate(derivative, clean + _draw_noise(record), record.dt, speed)
    off = (_target_rates(model, twice) - _target_rates(model, once))[:, once.inner]
    return float(np.sqrt(np.mean(off**2)))


def _mismatch(phi: Array, target: Array, noise: float) -> float:
    """eps_0: rms of what least squares leaves beyond noise, over the target's rms."""
    unit = phi / np.linalg.norm(phi, axis=0)
    solution = np.linalg.lstsq(unit, target, rcond=1e-10)[0]
    left = float(np.mean((target - unit @ solution) ** 2))
    whole = float(np.mean(target**2))
    return float(np.sqrt(max(left - noise**2, 0.0) / whole)) if whole > 0 else 0.0


def _advice(problem: Problem, identified: bool, aliases: tuple[tuple[str, ...], ...]) -> str:
    if identified:
        return "The record can tell these terms apart: spiral discover with the same overrides."
    groups = "; ".join(", ".join(g) for g in aliases)
    return f"This record cannot tell apart: {groups}. {_propose_test(problem)}"


def _propose_test(problem: Problem) -> str:
    """In words, a test that would tell the terms apart: an excitation or a speed sweep."""
    names = [i.name for i in problem.model.system.inputs]
    if "speed" not in names:
        name = next((i.name for i in problem.model.system.inputs if i.derived_from is None), "")
        plan = f"record.inputs='{{{name}: {{noise: 1.0}}}}'"
        return f"Excite with noise or a sweep; plan it with record=simulation {plan}."
    speed = np.concatenate([np.abs(r.inputs["speed"]) for r in problem.records])
    mean = float(np.mean(speed)) / (2 * np.pi)
    if mean == 0:
        raise ConfigError("a rotor at rest", "a record of a turning rotor")
    if np.std(speed) > _STEADY * np.mean(speed):
        return "Sweep the speed further, through the resonances, or ask for fewer candidates."
    plan = f"{{speed: {{sweep: [{1.8 * mean:.3g}, {0.2 * mean:.3g}], unit: Hz}}}}"
    return (
        f"The speed is constant at {mean:.3g} Hz: take a run-up or run-down instead; plan it with "
        f"spiral identify record=simulation record.inputs='{plan}'."
    )
