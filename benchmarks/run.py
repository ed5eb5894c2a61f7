"""Speed and memory, measured; every figure beside a reference of the same run (machines are noisy).

    python benchmarks/run.py

Passes in wall-clock seconds, whole commands in processor seconds of all their processes. The
reference is NumPy's QR decomposition of a 28 000 x 49 matrix with one thread: the least that a
regression on the same data costs. A ratio travels between machines better than seconds.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))


def best(work: Callable[[], object], repeats: int = 5) -> float:
    """Median seconds of several runs after one that warms up."""
    work()
    taken = []
    for _ in range(repeats):
        clock = time.perf_counter()
        work()
        taken.append(time.perf_counter() - clock)
    return float(np.median(taken))


def reference() -> float:
    """Seconds of the reference decomposition."""
    matrix = np.random.default_rng(0).normal(size=(28_000, 49))
    return best(lambda: np.linalg.qr(matrix, mode="r"))


def _problem():
    from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
    from spiral_plugins.systems.planar_rotor import PlanarRotor

    from spiral.inference.problem import Problem
    from spiral.io.registry import load_registry
    from spiral.types.model import seed_model

    model = seed_model(PlanarRotor())
    source = RotorCoastdown()
    candidates = load_registry(None).candidates(model.system)
    return Problem(
        model,
        source.load(model.system),
        replace(source, seed=1011, phase=1.3).load(model.system),
        candidates=tuple(e for e in candidates if e.label not in model.labels),
    )


def passes() -> list[tuple[str, float, str]]:
    """The compiled pass, the pass with its reduction, a fit, and a round."""
    from threadpoolctl import threadpool_limits

    from spiral.engine.growth import first_starts, layouts_for
    from spiral.engine.sensitivities import reduce_windows, residuals
    from spiral.engine.study import ParameterColumns, Point
    from spiral.inference.evidence.comparison import prepare_study
    from spiral.inference.evidence.fit_state import fit_growing_windows, half_masks
    from spiral.inference.evidence.scoring import score_stage

    problem = _problem()
    assembly, fit_state = prepare_study(problem)
    study = assembly.study
    count = min(48, len(study.keys))
    columns = ParameterColumns(np.arange(count), np.full(count, -1))
    layouts = layouts_for(study, 64, (None,))
    point = Point(fit_state.values, first_starts(study, layouts, fit_state.values))
    kernel = _kernel_only(study, layouts, point, columns)
    with threadpool_limits(limits=1, user_api="blas"):
        rows = [
            (f"compiled pass, 14 000 samples x {count} columns", best(kernel), "<= 0.05 s"),
            ("the same with elimination and blocks",
             best(lambda: reduce_windows(study, layouts, point, columns, 128)), ""),
            ("residuals only", best(lambda: residuals(study, layouts, point)), ""),
        ]  # fmt: skip
        mask = half_masks(assembly)[0]

        def a_round() -> None:
            for stage in fit_growing_windows(assembly, fit_state, mask):
                score_stage(assembly, fit_state, stage)

        rows.append(("a round of fit and score, all window lengths", best(a_round, 3), "<= 1.5 s"))
    return rows


def _kernel_only(study, layouts, point, columns) -> Callable[[], object]:
    """All windows through the integrator by two threads, rows written and dropped."""
    from spiral.engine import sensitivities

    weight = study.series[0].weight(None)
    batches = list(sensitivities._window_batches(layouts))

    def one(batch) -> None:
        starts = layouts[0].starts[batch.windows]
        n, width = study.state_count, study.state_count + columns.count
        s = np.zeros((len(starts), n, width))
        s[:, :, :n] = np.eye(n)
        rows = np.empty((len(starts), batch.length * 2, width + 1))
        sensitivities._advance_batch(
            study, study.series[0], study.series[0].inputs,
            point.starts[0][batch.windows].copy(), s, starts,
            batch.length, point.values[0], columns.index, weight, rows,
        )  # fmt: skip

    return lambda: sensitivities._map_batches(one, batches)


def commands() -> list[tuple[str, float, str]]:
    """Processor seconds of whole commands, with an empty cache and with a warm one.

    MLflow is told by a process that a command does not wait for; it is left out here.
    """
    spiral = str(Path(sys.executable).with_name("spiral"))
    rotor = ("experiment=rotor_coastdown", "tracking.enabled=false")
    demo = ("discover", *rotor)
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ, "NUMBA_CACHE_DIR": f"{folder}/numba",
            "XDG_CACHE_HOME": f"{folder}/xdg",
        }  # fmt: skip

        def run(*words: str) -> float:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(
                [spiral, *words], env=environment, cwd=folder, check=True, capture_output=True
            )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

        def median(*words: str) -> float:
            return float(np.median([run(*words) for _ in range(3)]))

        return [
            ("demo, nothing cached", run(*demo), "<= 20 s"),
            ("demo, warm", run(*demo), "<= 12 s"),
            ("spiral compare", median("compare", *rotor), "<= 3 s"),
            ("spiral compare strategy=shooting",
             median("compare", *rotor, "strategy=shooting"), "<= 3 s"),
            ("spiral plugins", median("plugins"), "< 1 s"),
            ("spiral --help", median("--help"), "< 1 s"),
        ]  # fmt: skip


def main() -> None:
    """Print the table."""
    unit = reference()
    print(f"{'reference: QR of 28 000 x 49':<58}{unit:>9.3f} s{1.0:>9.2f}")
    from benchmarks.filters import filters, sweeps

    for name, seconds, target in (*passes(), *filters(best), *commands(), *sweeps()):
        print(f"{name:<58}{seconds:>9.3f} s{seconds / unit:>9.2f}  {target}")


if __name__ == "__main__":
    main()
