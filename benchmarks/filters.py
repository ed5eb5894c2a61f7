"""The filter beside filterpy's on the same problem, and the paper's two sweeps."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Row = tuple[str, float, str]


def filters(best: Callable[[Callable[[], object]], float]) -> list[Row]:
    """28 000 samples of the tilting rotor, 8 states: ours, filterpy's, the smoother."""
    from spiral_plugins.observers.kalman import Rts
    from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
    from spiral_plugins.systems.tilting_rotor import TiltingRotor

    from benchmarks.peer_filter import compiled_functions, filterpy_run, numpy_functions
    from spiral.engine.filter.extended import filter_record
    from spiral.engine.filter.setup import prepare_filter, with_level
    from spiral.engine.filter.task import prepare_task
    from spiral.inference.simulate import with_defaults
    from spiral.types.model import seed_model

    system = TiltingRotor()
    record = RotorCoastdown(rate=2000.0).load(system)[0]
    task, settings = prepare_filter(
        prepare_task(with_defaults(seed_model(system)), record), track=()
    )
    levels = {"observed": 0.1, "hidden": 0.1}
    settings = with_level(task, settings, levels)
    wall = best(lambda: filter_record(task, settings))
    ours = min(_worked(lambda: filter_record(task, settings))[0] for _ in range(5))
    found = filter_record(task, settings).means
    rows = [("EKF, 28 000 samples x 8 states", wall, "<= 0.15 s")]
    for name, functions, wanted in (
        ("the same in filterpy, model in NumPy", numpy_functions(task), " (>= 50)"),
        ("the same in filterpy, our compiled model", compiled_functions(task), ""),
    ):
        theirs, peer = _worked(lambda f=functions: filterpy_run(task, settings, record.samples, f))
        gap = np.max(np.abs(peer.means - found) / np.abs(found).max(axis=0))
        rows.append(
            (name, theirs, f"{theirs / ours:.0f} times our processor time{wanted}, gap {gap:.0e}")
        )
    smoother = Rts(process_noise=levels, track=())
    return [*rows, ("RTS smoother on it", best(lambda: smoother.reconstruct(task)), "")]


def _worked(step: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of processor time, which other people's work on the machine does not change."""
    clock = time.process_time()
    found = step()
    return time.process_time() - clock, found


def sweeps() -> list[Row]:
    """Noise and mismatch, 20 seeds each, process noise tuned for every record, two processes."""
    command = [sys.executable, "-m", "experiments.hidden_states.run", "--only", "noise", "mismatch"]
    clock = time.perf_counter()
    subprocess.run(command, cwd=Path(__file__).parents[1], check=True, capture_output=True)
    taken = time.perf_counter() - clock
    return [("the paper's two sweeps, 160 records, tuned", taken, "<= 360 s")]
