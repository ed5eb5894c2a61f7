"""Records simulated from a system with effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.inference.excitation import excite
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.record import Array, Record, make_record
from spiral.types.source import Source
from spiral.types.system import System
from spiral.types.units import factor

if TYPE_CHECKING:
    from spiral.types.model import Model

_DECAY = np.log(1e4)  # the start-up transient is left at a ten-thousandth
_LONGEST_RUN_IN = 600.0  # s


class Simulation(Source):
    """A record simulated from a system, its seed and further effects, with declared noise.

    Fields
    ------
    system : whose equations are integrated; left out, the study's own. Channels and inputs are
        matched by name with the study's system, hidden states are kept as truth.
    effects, without : labels of effects added to that system's seed, and of seed effects left out.
    values : full parameter name -> value, on top of the system's nominal values.
    inputs : input -> description, e.g. ``{speed: {sweep: [40, 0], unit: Hz}}``.
    duration, rate : s and samples per s.
    seed : of the noise and of random inputs.
    noise_level : white noise as a share of each channel's standard deviation; declared.
    start : initial state by name; zero where left out.
    settled : run at the first speed before the record starts until the transient has gone.
    measured_phase : whether the record holds the phase, or it follows from speed again.
    """

    system: System | None = None
    effects: tuple[Effect, ...] = ()
    without: tuple[str, ...] = ()
    values: Mapping[str, float] | None = None
    inputs: Mapping[str, Any] | None = None
    duration: float = 10.0
    rate: float = 1000.0
    seed: int = 0
    noise_level: float = 0.02
    start: Mapping[str, float] | None = None
    settled: bool = False
    measured_phase: bool = True

    def __post_init__(self) -> None:
        for name in ("duration", "rate"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}={getattr(self, name)!r} of a simulation", "above zero")
        if not 0 <= self.noise_level < 10:
            raise ConfigError(f"noise_level={self.noise_level!r}", "a share, e.g. 0.02")
        if self.seed < 0:
            raise ConfigError(f"seed={self.seed!r} of a simulation", "zero or above")

    def as_test(self) -> Source:
        """The same machine with other noise."""
        return replace(self, seed=self.seed + 1000)

    def load(self, system: System) -> tuple[Record, ...]:
        """Integrate, add noise, and check the record against the study's system."""
        truth = self.truth(self.system or system)
        dt = 1.0 / self.rate
        time = dt * np.arange(round(self.duration * self.rate))
        for_inputs, for_noise = np.random.default_rng(self.seed).spawn(2)
        inputs = self._excite_inputs(truth.system, time, for_inputs)
        states, readings, inputs = self._integrate_record(truth, time, inputs)
        channels = dict(zip(truth.system.observed, readings.T, strict=True))
        noise = {c: self.noise_level * float(np.std(v)) for c, v in channels.items()}
        noisy = {c: v + for_noise.normal(0.0, 1.0, len(v)) * noise[c] for c, v in channels.items()}
        hidden = dict(zip((s.name for s in truth.system.states), states.T, strict=False))
        return (self._record_in_study_units(system, truth, time, noisy, inputs, noise, hidden),)

    def truth(self, system: System) -> Model:
        """The model that is integrated."""
        from spiral.inference.simulate import with_defaults
        from spiral.types.model import Model

        labels = [e.label for e in system.seed]
        for label in self.without:
            if label not in labels:
                raise ConfigError(
                    f"without {label!r}",
                    f"an effect of the seed: {', '.join(labels)}",
                    did_you_mean(label, labels),
                )
        kept = tuple(e for e in system.seed if e.label not in self.without)
        added = tuple(e for e in self.effects if e.label not in [k.label for k in kept])
        return with_defaults(Model(system, (*kept, *added), values=dict(self.values or {})))

    def _excite_inputs(
        self, system: System, time: Array, rng: np.random.Generator
    ) -> dict[str, Array]:
        given = dict(self.inputs or {})
        known = [i.name for i in system.inputs]
        for name in given:
            if name not in known:
                raise ConfigError(
                    f"input {name!r} of a simulation",
                    f"an input of {system.plugin_name()!r}: {', '.join(known) or 'none'}",
                    did_you_mean(name, known),
                )
        input_series = {}
        for item in system.inputs:
            if item.name in given:
                input_series[item.name] = excite(item.name, given[item.name], time, item.unit, rng)
            elif item.derived_from is None:
                raise ConfigError(
                    f"a simulation of {system.plugin_name()!r} without input {item.name!r}",
                    f"a description of {item.name!r} in {item.unit}",
                    f"record.inputs='{{{item.name}: {{constant: 1}}}}', or sweep, noise, "
                    "multisine, chirp in place of constant",
                )
        return input_series

    def _integrate_record(
        self, truth: Model, time: Array, inputs: dict[str, Array]
    ) -> tuple[Array, Array, dict[str, Array]]:
        """States, readings and completed inputs on ``time``, after a run-in where asked."""
        from spiral.inference.simulate import integrate

        before = self._run_in_samples(truth, inputs) if self.settled else 0
        dt = 1.0 / self.rate
        longer = dt * np.arange(-before, len(time)) + before * dt
        held = {k: np.concatenate([np.full(before, v[0]), v]) for k, v in inputs.items()}
        for item in truth.system.inputs:
            if item.name not in held and item.derived_from is not None:
                held[item.name] = _cumulative_integral(held[item.derived_from], longer, before)
        states, readings = integrate(truth, longer, held, self.start)
        return states[before:], readings[before:], {k: v[before:] for k, v in held.items()}

    def _run_in_samples(self, truth: Model, inputs: dict[str, Array]) -> int:
        """Samples after which the slowest motion about rest has decayed at the first inputs."""
        rate = _slowest_decay(truth, {k: float(v[0]) for k, v in inputs.items()})
        if not rate * _LONGEST_RUN_IN > _DECAY:
            raise ConfigError(
                "settled=true for a motion that hardly decays",
                f"a transient that is gone within {_LONGEST_RUN_IN:.0f} s",
                "give it damping, or record.settled=false",
            )
        return int(np.ceil(_DECAY / rate * self.rate))

    def _record_in_study_units(
        self,
        system: System,
        truth: Model,
        time: Array,
        channels: dict[str, Array],
        inputs: dict[str, Array],
        noise: dict[str, float],
        hidden: dict[str, Array],
    ) -> Record:
        """In the study's units; inputs that follow from others only where they are measured."""
        known = [i.name for i in system.inputs]
        derived = [
            i.name for i in truth.system.inputs if i.derived_from and not self.measured_phase
        ]
        scale = {c: _unit_factor(truth.system, system, c) for c in (*channels, *inputs, *hidden)}
        return make_record(
            system,
            f"simulated {truth.system.plugin_name()}, seed {self.seed}",
            time,
            {c: scale[c] * v for c, v in channels.items()},
            {k: scale[k] * v for k, v in inputs.items() if k in known and k not in derived},
            {c: scale[c] * v for c, v in noise.items() if v > 0},
            {k: scale[k] * v for k, v in hidden.items()},
        )


def _cumulative_integral(values: Array, time: Array, zero_at: int) -> Array:
    """Integral over time, zero at one sample."""
    from scipy.interpolate import CubicSpline

    whole = CubicSpline(time, values).antiderivative()(time)
    return whole - whole[zero_at]


def _unit_factor(source: System, target: System, name: str) -> float:
    """Factor from one system's unit of a channel or input to another's."""
    names = [i.name for i in (*target.states, *target.inputs)]
    if name not in names:
        return 1.0
    given, wanted = source.unit_of(name), target.unit_of(name)
    return 1.0 if given == wanted else factor(given, wanted, name)


def _slowest_decay(truth: Model, first: dict[str, float]) -> float:
    """Smallest -Re(eigenvalue) of f_x at rest, 1/s."""
    from spiral.physics.trace import trace

    traced = trace(truth.system, truth.effects)
    at = dict.fromkeys(traced.x, 0.0)
    at.update({s: first.get(n, 0.0) for n, s in zip(traced.inputs, traced.u, strict=True)})
    start = {k: p.start for k, p in truth.pairs}
    values = {**start, **truth.values}
    at.update({s: values[k] or 0.0 for k, s in zip(traced.keys, traced.p, strict=True)})
    matrix = np.array(traced.rate_x.subs(at).evalf().tolist(), dtype=float)
    return float(np.min(-np.linalg.eigvals(matrix).real))
