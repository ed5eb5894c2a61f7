"""From a machine, an imperfection and a seed to a question."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from experiments.hidden_effects.cases import installed
from experiments.imperfections.motion import disturbed, undisturbed
from experiments.imperfections.rows import NOISE, ROWS, Imperfection, coloured_force
from experiments.imperfections.scenes import DRIFT, LENGTH, SCENES, Scene
from experiments.studies.pieces import version
from experiments.studies.question import Question, misjudged, model_of
from spiral.types.record import Record, make_record
from spiral.types.system import System

Array = np.ndarray
HERE = Path(__file__).parent
NULL = " null"


def cases() -> tuple[str, ...]:
    """Every row with its effect hidden, and with none."""
    return tuple(name + end for name in ROWS for end in ("", NULL))


def question(name: str, case: str, seed: int) -> Question:
    """What a user asks about a record with an imperfection that nobody told of."""
    scene, row = SCENES[name], ROWS[case.removesuffix(NULL)]
    hidden = {} if case.endswith(NULL) else dict(scene.hidden)
    system = installed().make("system", scene.system)
    known = model_of(system, scene.values, ())
    wrong = misjudged(known, np.random.default_rng([seed, 99]))
    pairs = [measured(scene, system, row, hidden, seed, i) for i in range(2)]
    truth = {k: v for k, v in scene.values.items() if not k.endswith("phase_origin")}
    return Question(
        system,
        (pairs[0][0],),
        (pairs[1][0],),
        {"values": {**known.values, **wrong}, "plugins": installed()},
        tuple(dict.fromkeys(k.rsplit(".", 1)[0] for k in hidden)),
        {**truth, **hidden},
        row.also,
        pairs[1][1],
    )


def measured(
    scene: Scene,
    system: System,
    row: Imperfection,
    hidden: Mapping[str, float],
    seed: int,
    number: int,
) -> tuple[Record, float]:
    """A record, and the error that its noise makes, over the standard deviation (mean)."""
    rng = np.random.default_rng([seed, number])
    signals = scene.excite(rng, scene.duration)
    values = {**scene.values, **hidden, DRIFT: row.drift, LENGTH: scene.duration}
    if row.push is None:
        states = undisturbed(scene, values, signals)
    else:
        lasting = row.lasting / scene.resonance
        push = partial(coloured_force, lasting=lasting) if lasting else row.push
        states = disturbed(scene, values, signals, push, row.share, rng)
    true = states[:, : scene.axes]
    read = [_read(scene, row, true[:, i], i == scene.axes - 1, rng) for i in range(scene.axes)]
    channels = dict(zip(system.observed, (y for y, _ in read), strict=True))
    noise = {
        c: row.declared * NOISE * float(true[:, i].std())
        for i, c in enumerate(system.observed)
        if row.declared is not None
    }
    time = scene.time()
    inputs = _inputs(scene, row, {k: signals[k](time) for k in scene.measured}, rng)
    told = f"{scene.system}, record {number + 1} of seed {seed}"
    return make_record(system, told, time, channels, inputs, noise), float(
        np.mean([e for _, e in read])
    )


def _read(
    scene: Scene, row: Imperfection, true: Array, last: bool, rng: np.random.Generator
) -> tuple[Array, float]:
    """One channel as read, and what noise makes of it over its standard deviation.

    What a sensor does to every motion alike (an offset, a lag, a drift) is no noise; neither are
    samples that are spoilt.
    """
    step, ideal = 1.0 / scene.samples_per_s, true
    if row.before is not None and (last or not row.last):
        ideal = row.before(rng, true, step, scene.resonance)
    noisy = ideal + NOISE * true.std() * row.noise(rng, true)
    read = noisy if row.after is None else row.after(rng, noisy, step, scene.resonance)
    kept = read == noisy if row.spoils else np.ones(len(read), dtype=bool)
    return read, float(np.sqrt(np.mean((read - ideal)[kept] ** 2)) / read.std())


def _inputs(
    scene: Scene, row: Imperfection, inputs: dict[str, Array], rng: np.random.Generator
) -> dict[str, Array]:
    """Inputs as the record holds them; a phase that is not measured follows from a noisy speed."""
    if row.input_noise:
        first = scene.measured[0]
        size = row.input_noise * np.sqrt(np.mean(inputs[first] ** 2))
        return {first: inputs[first] + rng.normal(0.0, size, len(inputs[first]))}
    if row.input_late:
        count = row.input_late
        return {k: np.concatenate([v[:1].repeat(count), v[:-count]]) for k, v in inputs.items()}
    return inputs


def definition(name: str) -> str:
    """The version of what makes the records and the question."""
    shared = (HERE.parent / "studies" / n for n in ("signals.py", "trajectory.py", "question.py"))
    own = (HERE / n for n in ("cases.py", "motion.py", "rows.py", "scenes.py"))
    return version(*own, *shared)
