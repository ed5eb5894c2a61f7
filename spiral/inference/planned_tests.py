"""The tests that ``spiral plan`` judges: listed from what a user wishes, simulated by plugins."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from spiral.inference.plan import PlannedTest, Simulate
from spiral.inference.plan_options import PlanOptions
from spiral.inference.problem import Problem
from spiral.types.errors import ConfigError
from spiral.types.model import Model
from spiral.types.parameter import Input
from spiral.types.record import Array, Record
from spiral.types.source import Source

MakeSource = Callable[[Mapping[str, Any]], Source]

_MOST = 200  # tests in one plan
_RANDOM = ("noise", "multisine")
_PEAK = 4.0  # deviations that random waveforms hardly exceed


def planned_tests(problem: Problem, wishes: PlanOptions) -> tuple[PlannedTest, ...]:
    """Every combination of what the wishes leave open.

    Raises
    ------
    ConfigError : more than 200 of them, or a system without an input to vary.
    """
    inputs = [i for i in problem.model.system.inputs if i.derived_from is None]
    if not inputs:
        raise ConfigError("a system without inputs", "an input that a test can vary")
    duration = max(r.samples * r.dt for r in problem.records)
    durations = wishes.durations or (0.5 * duration, duration, 2 * duration)
    rates = wishes.rates or (1.0 / problem.records[0].dt,)
    turning = next((i for i in inputs if i.name == "speed"), None)
    drives = (
        _speed_drives(problem, wishes) if turning else _waveform_drives(problem, wishes, inputs[0])
    )
    weights = (wishes.unbalances or (1.0, 3.0)) if turning else (1.0,)
    if not any(e.undirected() for e in problem.model.effects):
        weights = (1.0,)
    start = {} if turning else _first_readings(problem)  # a machine that turns has run in
    tests = tuple(
        _planned_test(words, given, seconds, rate, weight, start)
        for (words, given), seconds, rate, weight in itertools.product(
            drives, durations, rates, weights
        )
    )
    if len(tests) > _MOST:
        raise ConfigError(
            f"a plan of {len(tests)} tests", f"at most {_MOST}", "fewer speeds, durations, rates"
        )
    return tests


def _first_readings(problem: Problem) -> dict[str, float]:
    """States where the first record begins, as far as readings tell."""
    states, record = problem.model.system.states, problem.records[0]
    names = {s.name for s in states}
    read = {n: float(f"{v[0]:.4g}") for n, v in record.channels.items() if n in names}
    return {**read, **{s.name: read[s.like] for s in states if s.like in read}}


def _planned_test(
    words: str, inputs: Mapping[str, Any], seconds: float, rate: float, weight: float,
    start: Mapping[str, float],
) -> PlannedTest:  # fmt: skip
    told = f"{words} in {seconds:.4g} s, {rate:.4g}/s"
    if weight != 1.0:
        told += f", unbalance x {weight:g}"
    return PlannedTest(told, inputs, float(seconds), float(rate), float(weight), start)


def _speed_drives(problem: Problem, wishes: PlanOptions) -> list[tuple[str, dict[str, Any]]]:
    """Speed sweeps in words and as inputs: the range at hand, half of it, half as much again."""
    speed = np.concatenate([r.inputs["speed"] for r in problem.records]) / (2 * np.pi)
    top = float(np.max(np.abs(speed)))
    usual = ([0.5 * top, 0.0], [top, 0.0], [1.5 * top, 0.0], [0.5 * top, 1.5 * top], [top, top])
    drives = []
    for given in wishes.speeds or usual:
        ends = list(given) if isinstance(given, list | tuple) else [given, given]
        if len(ends) != 2 or not all(isinstance(e, int | float) for e in ends):
            raise ConfigError(f"plan.speeds: {given!r}", "[from, to] in Hz", "plan.speeds=[[40,0]]")
        first, last = (float(f"{e:.4g}") for e in ends)
        words = f"{first:g} to {last:g} Hz" if first != last else f"steady {first:g} Hz"
        drives.append((words, {"speed": {"sweep": [first, last], "unit": "Hz"}}))
    return drives


def _waveform_drives(
    problem: Problem, wishes: PlanOptions, item: Input
) -> list[tuple[str, dict[str, Any]]]:
    """Waveforms of the first input, about its mean; other inputs stay at their means.

    One that never changes its sign in the records does not in a test either, unless amplitudes are
    asked for: a heater does not cool.
    """
    rest = {
        i.name: {"constant": float(np.mean(_input_values(problem, i.name)))}
        for i in problem.model.system.inputs
        if i.derived_from is None and i.name != item.name
    }
    values, band = _input_values(problem, item.name), _occupied_band(problem, item)
    size, mean = float(np.std(values)), float(np.mean(values))
    one_sign = not wishes.amplitudes and (values.min() >= 0 or values.max() <= 0)
    offset = {"offset": float(f"{mean:.4g}")} if abs(mean) > 0.05 * size else {}
    top = 0.45 / problem.records[0].dt
    bands = wishes.bands or (band, (band[0], min(2 * band[1], top)))
    drives = []
    for form, factor, (low, high) in itertools.product(
        wishes.forms or ("noise", "chirp"), wishes.amplitudes or (0.5, 1.0, 2.0), bands
    ):
        level = factor * size * (1.0 if form in _RANDOM else np.sqrt(2))
        if one_sign:
            level = min(level, abs(mean) / (_PEAK if form in _RANDOM else 1.0))
        level = float(f"{level:.4g}")
        edges = [float(f"{low:.3g}"), float(f"{high:.3g}")]
        words = f"{item.name}: {form} of {level:g} {item.unit}, {edges[0]:g} to {edges[1]:g} Hz"
        drives.append((words, {item.name: {form: level, "band": edges, **offset}, **rest}))
    return list({words: (words, given) for words, given in drives}.values())


def _input_values(problem: Problem, name: str) -> Array:
    """An input of all records, one after the other."""
    return np.concatenate([r.inputs[name] for r in problem.records])


def _occupied_band(problem: Problem, item: Input) -> tuple[float, float]:
    """Frequencies between which nine tenths of the first record's input lie, Hz."""
    record = problem.records[0]
    values = record.inputs[item.name] - np.mean(record.inputs[item.name])
    power = np.cumsum(np.abs(np.fft.rfft(values)) ** 2)
    frequency = np.fft.rfftfreq(len(values), record.dt)
    low, high = (frequency[np.searchsorted(power, s * power[-1])] for s in (0.05, 0.95))
    return max(float(low), float(frequency[1])), max(float(high), float(3 * frequency[1]))


def simulator(problem: Problem, make: MakeSource, seed: int = 0) -> Simulate:
    """Simulates a test as ``record=simulation`` does; a turning machine has run in before.

    ``make`` : fields of that source -> the source (``spiral.io.registry`` knows it).
    """
    measured = all("phase" in r.measured for r in problem.records)

    def simulate_test(model: Model, test: PlannedTest) -> Record:
        fields = {
            **simulation_fields(model, test),
            "seed": seed,
            "measured_phase": measured,
        }
        fields |= {
            "effects": _unseeded_effects(model),
            "without": _removed_labels(model),
            "noise_level": 0.0,
        }
        try:
            return _load_single_record(make(fields), model)
        except ConfigError as error:
            if "settled" not in error.given:
                raise
            return _load_single_record(make({**fields, "settled": False}), model)

    return simulate_test


def _load_single_record(source: Source, model: Model) -> Record:
    (record,) = source.load(model.system)
    return replace(record, name="planned")


def simulation_fields(model: Model, test: PlannedTest) -> dict[str, Any]:
    """Fields of ``record=simulation`` that make a test of a model."""
    known = {k for k, _ in model.pairs}
    return {
        "start": dict(test.start),
        "values": {k: float(v) for k, v in model.values.items() if k in known},
        "inputs": dict(test.inputs),
        "duration": test.duration,
        "rate": test.rate,
        "settled": "speed" in test.inputs,
    }


def _unseeded_effects(model: Model) -> tuple[Any, ...]:
    seeded = [e.label for e in model.system.seed]
    return tuple(e for e in model.effects if e.label not in seeded)


def _removed_labels(model: Model) -> tuple[str, ...]:
    return tuple(e.label for e in model.system.seed if e.label not in model.labels)


def record_overrides(test: PlannedTest, noise_level: float, model: Model) -> tuple[str, ...]:
    """The same test on the command line: ``record.FIELD=VALUE`` of ``record=simulation``."""
    words = [f"record.inputs={_format_plain(test.inputs)}", f"record.duration={test.duration:g}"]
    words += [f"record.rate={test.rate:g}", f"record.noise_level={noise_level:.4g}"]
    words += ["record.settled=true"] if "speed" in test.inputs else []
    words += [f"record.start={_format_plain(test.start)}"] if any(test.start.values()) else []
    for effect in model.effects:
        if effect.undirected() and test.unbalance != 1.0:
            key = f"{effect.label}.{effect.amplitudes()[0].name}"
            words.append(f"record.values.{key}={model.values[key] * test.unbalance:.6g}")
    return tuple(words)


def _format_plain(value: Any) -> str:
    """Plain data as the command line's grammar writes it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_format_plain(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_format_plain(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
