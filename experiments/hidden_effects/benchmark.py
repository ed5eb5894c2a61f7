"""The benchmark: every effect hidden, at three strengths and three noises, beside null records.

python -m experiments.hidden_effects.benchmark [--seeds 10] [--out runs/hidden_effects]
    [--systems NAME ...] [--strengths medium] [--noises 0.02] [--only EFFECT ...]
    [--strategy likelihood] [--jobs -1]

Rows are kept as they end (rows.jsonl); the same command takes up what is there.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed, parallel_config

from experiments.hidden_effects.cases import Case, installed, problem
from experiments.hidden_effects.strengths import (
    NOISES,
    SCENES,
    SHARES,
    Hidden,
    effects_of,
    strengths,
)
from experiments.hidden_effects.summary import conclude
from experiments.studies.outcomes import coefficient, named
from spiral.inference.discover import discover
from spiral.io.problem_setup import USUAL_STRATEGY
from spiral.io.registry import Registry
from spiral.types.errors import ConfigError
from spiral.types.run import Run

ROUNDS = 2  # one for the hidden effect, one in which nothing more may be admitted


@dataclass(frozen=True)
class Job:
    """One study: a hidden effect, or none, at a noise and a seed, by a strategy."""

    hidden: Hidden
    noise: float
    seed: int
    strategy: str = USUAL_STRATEGY

    @property
    def key(self) -> str:
        """Its name among the rows."""
        h = self.hidden
        case = f"{h.system} {h.effect or 'null'} {h.strength} {self.noise} {self.seed}"
        return f"{case} {self.strategy}"


def study(job: Job) -> dict[str, Any] | None:
    """One study: what was found, what was invented, and how the test error moved.

    ``seconds`` are of one processor, whatever else the machine does. Nothing where the true motion
    runs away under this seed's excitation, as a spring that softens may.
    """
    hidden, clock = job.hidden, time.process_time()
    case = hidden.case if hidden.effect else Case("", {}, SCENES[hidden.system])
    try:
        given = problem(case, installed(), job.seed, job.noise, ROUNDS, job.strategy)
    except ConfigError:
        return None
    run = discover(given)
    found = {
        "key": job.key,
        "system": hidden.system,
        "hidden": hidden.effect or None,
        "strength": hidden.strength,
        "share": hidden.share,
        "noise": job.noise,
        "seed": job.seed,
        "identifiable": bool(hidden.effect) and hidden.identifiable(job.noise),
        "verdict": run.verdict,
        "before": run.rounds[0].comparison.test_error,
        "after": run.rounds[-1].comparison.test_error,
        "floor": run.rounds[-1].comparison.noise_floor,
    }
    found |= _named(run, hidden)
    return {**found, "seconds": time.process_time() - clock}


def _named(run: Run, hidden: Hidden) -> dict[str, Any]:
    """Ranks of the hidden effect, what was invented beside it, and its coefficient's error."""
    label = hidden.effect
    truth = {f"{label}.{name}": value for name, value in hidden.values.items()}
    return {
        **named(run, (label,) if label else ()),
        "error_se": coefficient(run, truth)["error_se"],
    }


def jobs_of(given: argparse.Namespace, registry: Registry) -> list[Job]:
    """All hidden effects, and as many null records."""
    pairs = [
        (s, e)
        for s in given.systems
        for e in effects_of(s, registry)
        if not given.only or e in given.only
    ]
    made = Parallel(n_jobs=given.jobs)(delayed(_strengths)(s, e) for s, e in pairs)
    hidden = [h for group in made for h in group if h.strength in given.strengths]
    full = [
        Job(h, n, s + 1, given.strategy)
        for h in hidden for n in given.noises for s in range(given.seeds)
    ]  # fmt: skip
    return full + _nulls(full)


def _strengths(system: str, label: str) -> list[Hidden]:
    return strengths(system, label, installed())


def _nulls(full: list[Job]) -> list[Job]:
    """Null records of each system and noise, in equal number, no seed twice."""
    counts: dict[tuple[str, float], int] = {}
    found = []
    for job in full:
        place = (job.hidden.system, job.noise)
        counts[place] = counts.get(place, 0) + 1
        none = Hidden(job.hidden.system, "", "none", {}, 0.0, 0.0)
        found.append(Job(none, job.noise, 100_000 + counts[place], job.strategy))
    return found


def rows_of(jobs: list[Job], file: Path, workers: int) -> list[dict[str, Any]]:
    """Rows of all jobs; those that an earlier start left are taken, the others computed."""
    kept = {r["key"]: r for r in map(json.loads, file.read_text().splitlines())} if (
        file.exists()
    ) else {}  # fmt: skip
    wanted = {j.key for j in jobs}
    rows = [r for k, r in kept.items() if k in wanted]
    left = [j for j in jobs if j.key not in kept]
    clock = time.perf_counter()
    with file.open("a") as out:
        for number, row in enumerate(_computed(left, workers), 1):
            if row is None:
                print("left out: the true motion runs away", file=sys.stderr)
                continue
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            if number % max(1, len(left) // 50) == 0 or number == len(left):
                spent = time.perf_counter() - clock
                ahead = spent / number * (len(left) - number)
                print(f"{number} of {len(left)}, {spent:.0f} s, {ahead:.0f} s to go",
                      file=sys.stderr)  # fmt: skip
    return rows


def _computed(jobs: list[Job], workers: int) -> Iterator[dict[str, Any] | None]:
    """Rows as they end; one thread each, models compiled once and cached on disk."""
    with parallel_config("loky", inner_max_num_threads=1):
        yield from Parallel(n_jobs=workers, return_as="generator_unordered")(
            delayed(study)(job) for job in jobs
        )


def parsed(words: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", nargs="*", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--only", nargs="*", help="effects to hide; all when left out")
    parser.add_argument("--strengths", nargs="*", default=list(SHARES), choices=list(SHARES))
    parser.add_argument("--noises", nargs="*", type=float, default=list(NOISES))
    parser.add_argument("--seeds", type=int, default=10, help="records per case")
    parser.add_argument("--strategy", default=USUAL_STRATEGY, help="the default one if left out")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: every processor")
    parser.add_argument("--out", default="runs/hidden_effects", help="folder of the results")
    parser.add_argument("--no-tracking", action="store_true", help="do not tell MLflow")
    return parser.parse_args(words)


def main(words: list[str] | None = None) -> dict[str, Any]:
    """Run the jobs, write and print the tables, tell MLflow; returns the summary."""
    given, clock = parsed(words), time.perf_counter()
    folder = Path(given.out)
    folder.mkdir(parents=True, exist_ok=True)
    jobs = jobs_of(given, installed())
    print(f"{len(jobs)} studies, half of them null records", file=sys.stderr)
    rows = rows_of(jobs, folder / "rows.jsonl", given.jobs)
    return conclude(rows, folder, time.perf_counter() - clock, not given.no_tracking)


if __name__ == "__main__":
    main()
