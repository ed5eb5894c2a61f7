"""Cost against the number of samples, from 10^4 to 10^6, and the peak memory at the end.

    python benchmarks/scaling.py [MOST]

Each size runs in a process of its own: a longer run-down of the rotor at 1 kHz, the planar seed and
all candidates. The slope is that of log seconds on log samples (1: linear). Fixed costs (imports,
compilation) come before the clock starts.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SIZES = (10_000, 30_000, 100_000, 300_000, 1_000_000)
STEPS = ("first values", "fit and score", "free run and whiteness")


def measured(samples: int) -> dict[str, float]:
    """Seconds of each step of a round, and the process's peak memory in GiB."""
    from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
    from spiral_plugins.systems.planar_rotor import PlanarRotor

    from spiral.engine.threads import one_blas_thread
    from spiral.inference.evidence.comparison import compare_fit, prepare_study
    from spiral.inference.evidence.fit_state import fit_growing_windows, half_masks
    from spiral.inference.evidence.scoring import score_stage
    from spiral.inference.problem import Problem
    from spiral.io.registry import load_registry
    from spiral.types.model import seed_model

    model = seed_model(PlanarRotor())
    source = RotorCoastdown(duration=samples / 1000)
    found = load_registry(None).candidates(model.system)
    problem = Problem(
        model,
        source.load(model.system),
        replace(source, duration=14.0, seed=1011, phase=1.3).load(model.system),
        candidates=tuple(e for e in found if e.label not in model.labels),
    )
    small = replace(problem, records=(problem.records[0].part(0, 5000, "small"),))
    prepare_study(small)  # compiled before the clock starts

    @one_blas_thread
    def steps() -> list[float]:
        clocks = [time.perf_counter()]
        assembly, fit_state = prepare_study(problem)
        clocks.append(time.perf_counter())
        for stage in fit_growing_windows(assembly, fit_state, half_masks(assembly)[0]):
            score_stage(assembly, fit_state, stage)
        clocks.append(time.perf_counter())
        compare_fit(assembly, replace(fit_state, values=stage.fitted.point.values), stage)
        clocks.append(time.perf_counter())
        return list(np.diff(clocks))

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    taken = dict(zip(STEPS, steps(), strict=True))
    peak = max(peak, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return {**taken, "peak_gib": peak / 2**20}


def in_own_process(samples: int) -> dict[str, float]:
    """The same in a fresh process, so that peaks do not mix."""
    command = [sys.executable, __file__, "--one", str(samples)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def table(most: int) -> list[str]:
    """A line for each size, then the slopes."""
    sizes = [n for n in SIZES if n <= most]
    rows = [in_own_process(n) for n in sizes]
    lines = [f"{'samples':>9}  " + "  ".join(f"{s:>22}" for s in STEPS) + "  peak memory"]
    lines += [
        f"{n:>9}  "
        + "  ".join(f"{row[s]:>20.2f} s" for s in STEPS)
        + f"  {row['peak_gib']:>7.2f} GiB"
        for n, row in zip(sizes, rows, strict=True)
    ]
    slopes = [np.polyfit(np.log(sizes), np.log([r[s] for r in rows]), 1)[0] for s in STEPS]
    lines.append(f"{'slope':>9}  " + "  ".join(f"{s:>22.2f}" for s in slopes) + "  <= 2 GiB")
    return lines


def main() -> None:
    """Print the table, or one size as JSON."""
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measured(int(sys.argv[2]))))
        return
    print("\n".join(table(int(sys.argv[1]) if len(sys.argv) > 1 else SIZES[-1])))


if __name__ == "__main__":
    main()
