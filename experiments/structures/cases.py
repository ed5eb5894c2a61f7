"""Forty cases: two structures, three effects, every place; strengths that change the readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import spiral
from experiments.structures.kinds import KINDS, Kind
from experiments.structures.truth import LAWS, STEPS, compliance, motion, told
from experiments.studies.pieces import version
from experiments.studies.question import Question
from experiments.studies.signals import band_limited
from spiral.types.record import make_record

SIZE = 20
SECONDS = 2.0
SHARES = (0.08, 0.25)
"""Least and most that what is hidden changes the readings, rms over rms."""
GUESSED = 0.8
"""The user's damping ratio, of the true one; it is free."""
_TRIES = 10


@dataclass(frozen=True)
class Drawn:
    """What a case is: an effect at a place, its values, and what it changes."""

    effect: str
    port: str
    values: dict[str, float]
    share: float


def of_case(name: str, number: int) -> tuple[str, str]:
    """Effect and place of a case: each effect in turn, the places in a shuffled row."""
    effects = [e for e in LAWS if e != "none"]
    places = KINDS[name]().places
    order = np.random.default_rng([len(name), 7]).permutation(len(places))
    return effects[number % 3], places[order[(number // 3 + number) % len(places)]]


@cache
def structure(name: str, ratio: float):
    """The structure as a user opens it."""
    kind = KINDS[name]()
    return spiral.structure(
        kind.matrices, {n: dict(v) for n, v in kind.nodes.items()}, size=SIZE, band=kind.band,
        pairs=kind.pairs, damping_ratio=ratio,
    )  # fmt: skip


def question(name: str, number: int, half: int) -> tuple[Question, Drawn]:
    """The record and what is asked; ``half`` tells seeds of development from those of reports."""
    kind, rng = KINDS[name](), np.random.default_rng([half, number, len(name)])
    effect, port = of_case(name, number)
    ratio, speed = rng.uniform(0.005, 0.02), rng.uniform(*(kind.speeds or (0.0, 0.0)))
    least = 1.0 / kind.rate
    signal = band_limited(rng, kind.drive, (5.0, 120.0), SECONDS)
    fine = np.arange(round(SECONDS * kind.rate) * STEPS + 1) * (least / STEPS)
    drawn, y = _hidden(kind, effect, port, rng, (ratio, speed), signal(fine), least / STEPS)
    system, label = structure(name, GUESSED * ratio), f"{effect}@{port}"
    names, level = list(kind.nodes), rng.uniform(0.01, 0.02)
    channels = {n: y[:, names.index(n)] for n in kind.using("sensor")}
    channels = {n: c + level * c.std() * rng.normal(size=c.size) for n, c in channels.items()}
    time = fine[::STEPS]
    inputs = {f"force_{kind.using('input')[0]}": signal(time)}
    inputs |= {"speed": np.full(len(time), speed)} if kind.speeds else {}
    record = make_record(system, f"{name} {number}", time, channels, inputs)
    short = label if port != kind.places[0] else effect
    truth = {f"{short}.{k}": v for k, v in drawn.values.items()}
    asked = Question(system, (record,), (), {"free": ["system.damping_ratio"]}, (short,), truth)
    return asked, drawn


def _hidden(kind: Kind, effect, port, rng, how, force, step) -> tuple[Drawn, np.ndarray]:
    """An effect as strong as it has to be, sought by bisection of its logarithm, and the motion."""
    wanted = np.exp(rng.uniform(*np.log(SHARES)))
    seen = [i for i, n in enumerate(kind.nodes) if n in kind.using("sensor")]
    linear, alone = motion(kind.name, port, "none", (0.0, 0.0), *how, force, step)
    reach, gap = float(np.abs(alone).max()), rng.uniform(0.3, 0.6)
    rms = float(alone.std())
    pace = float(np.gradient(alone, STEPS * step).std())
    hold = 1.0 / compliance(kind.name, port)
    low, high = (-6.0, 2.0)
    for _ in range(_TRIES):
        power = 0.5 * (low + high)
        values = {
            "cubic_stiffness": {"stiffness": 10**power * hold / rms**2},
            "clearance": {"stiffness": 10**power * hold, "gap": gap * reach},
            "coulomb_friction": {"level": 10**power * hold * rms, "width": 0.01 * pace},
        }[effect]
        y, _ = motion(kind.name, port, effect, told(values), *how, force, step)
        share = float(np.sqrt(np.mean((y - linear)[:, seen] ** 2 / linear[:, seen].var(axis=0))))
        if abs(np.log(share / wanted)) < 0.1:
            break
        low, high = (power, high) if share < wanted else (low, power)
    return Drawn(effect, port, values, share), y


def definition() -> str:
    """The version of what makes the records and the question."""
    return version(Path(__file__).parent)
