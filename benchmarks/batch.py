"""A thousand simulations of a rotor: by JAX on processors and on a graphics card, and one by one.

    python benchmarks/batch.py [SIMULATIONS] [SAMPLES]

The planar rotor (4 states, 2 readings, 8 Runge-Kutta steps per sample), in double precision. One by
one is the compiled loop (``engine.kernel.trajectories``), on one core and on all; ratios are to one
core. ``records`` have inputs, starts and values of their own, ``seeds`` starts and values alone.
*Prepared* leaves out what both need before (splines through the inputs); *on the device* leaves out
the copies there and back, too. Compilation is told apart. The largest difference from the loop's
numbers, over the largest number, stands beside each row.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

RATE, SUBSTEPS, CHECKED = 1000.0, 8, 8
BY = ("unbalance.moment", "linear_stiffness.stiffness_x", "linear_damping.damping_x", "x")
VALUES = {
    "system.phase_origin": 0.4, "linear_stiffness.stiffness_x": 1e4,
    "linear_stiffness.stiffness_y": 1.2e4, "linear_damping.damping_x": 5.0,
    "linear_damping.damping_y": 3.0, "unbalance.moment": 1e-5,
}  # fmt: skip


def clocked(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Median seconds, and the last result."""
    taken, result = [], None
    for _ in range(repeats):
        clock = time.perf_counter()
        result = work()
        taken.append(time.perf_counter() - clock)
    return float(np.median(taken)), result


class Case:
    """Records of one rotor: speeds (simulations, samples), starts and values."""

    def __init__(self, simulations: int, samples: int) -> None:
        from spiral_plugins.systems.planar_rotor import PlanarRotor

        from spiral.physics.trace import trace
        from spiral.types.model import seed_model

        rng = np.random.default_rng(0)
        self.model = seed_model(PlanarRotor(), values=VALUES)
        self.traced = trace(self.model.system, self.model.effects)
        self.time = np.arange(samples) / RATE
        sweep = np.linspace(2 * np.pi * 40, 2 * np.pi * 25, samples)
        self.speeds = sweep * (1 + 0.02 * rng.normal(size=(simulations, 1)))
        self.values = {k: v * (1 + 0.01 * rng.normal(size=simulations)) for k, v in VALUES.items()}
        self.start = {"x": 1e-6 * rng.normal(size=simulations)}

    @property
    def count(self) -> int:
        """Number of simulations."""
        return len(self.speeds)

    def stages(self, k: int) -> np.ndarray:
        """Inputs of a record at the stages, as the compiled loop takes them."""
        from spiral.engine.series import stage_inputs
        from spiral.types.record import make_record

        quiet = np.random.default_rng(k).normal(size=(2, len(self.time)))
        channels = dict(zip(("x", "y"), quiet, strict=True))
        record = make_record(
            self.model.system, "one", self.time, channels, {"speed": self.speeds[k]}
        )
        return stage_inputs(self.model.system, record, SUBSTEPS)

    def loop(self, k: int, stages: np.ndarray) -> np.ndarray:
        """Readings (samples, 2) of one simulation by the compiled loop."""
        from spiral.engine.kernel import trajectories
        from spiral.physics.compile import compile_model

        compiled = compile_model(self.traced)
        x = np.array([[self.start["x"][k], 0.0, 0.0, 0.0]])
        p = np.array([[self.values[key][k] for key in self.traced.keys]])
        states, readings = np.empty((len(self.time), 4)), np.empty((len(self.time), 2))
        trajectories(
            compiled.rate_value, compiled.output_value, x, np.zeros(1, dtype=np.int64),
            np.array([len(self.time)]), p, stages, SUBSTEPS, 1 / RATE, states, readings,
        )  # fmt: skip
        return readings

    def whole(self, device: str, slopes: tuple[str, ...] = (), shared: bool = False) -> Any:
        """All simulations from their inputs, as a user asks for them."""
        from spiral.inference.simulate_batch import simulate_batch

        speeds = self.speeds[0] if shared else self.speeds
        return simulate_batch(
            self.model, self.time, {"speed": speeds}, self.values, self.start, slopes, device,
            SUBSTEPS,
        )  # fmt: skip

    def prepared(self, device: str, shared: bool = False, slopes: tuple[str, ...] = ()) -> Any:
        """Functions: all simulations from prepared inputs; the same with all on the device."""
        from spiral.engine import batch
        from spiral.engine.batch_inputs import lay_out_inputs

        jax, chosen = batch.import_jax(), batch.find_device(device)
        speeds = self.speeds[0] if shared else self.speeds
        names = ("speed", "phase", "speed_rate")
        columns = lay_out_inputs(self.model.system, self.time, {"speed": speeds}, SUBSTEPS, names)
        starts = np.zeros((self.count, 4))
        starts[:, 0] = self.start["x"]
        rows = [self.values[key] for key in self.traced.keys]
        run, arguments = batch.batch_call(
            self.traced, starts, rows, columns, len(self.time), 1 / RATE, SUBSTEPS, slopes, chosen
        )

        def there_and_back() -> Any:
            return batch.integrate_batch(
                self.traced, starts, rows, columns, len(self.time), 1 / RATE, SUBSTEPS, slopes,
                chosen,
            )  # fmt: skip

        with batch.double_precision():
            there = jax.block_until_ready(jax.device_put(arguments, chosen))

        def on_the_device() -> Any:
            with batch.double_precision():
                return jax.block_until_ready(run(*there))

        return there_and_back, on_the_device


def one_by_one(case: Case) -> tuple[list[tuple[str, float, str]], list[np.ndarray]]:
    """Seconds of all simulations by the loop, on one core and on all; readings of a few."""
    from spiral.engine.threads import run_in_threads

    some = [case.stages(k) for k in range(min(CHECKED, case.count))]
    readings = [case.loop(k, stages) for k, stages in enumerate(some)]

    def loop(k: int) -> None:
        case.loop(k, some[k % len(some)])

    one, _ = clocked(lambda: [loop(k) for k in range(case.count)], 1)
    many, _ = clocked(lambda: run_in_threads(loop, range(case.count)), 1)
    before, _ = clocked(lambda: [case.stages(k) for k in range(len(some))], 1)
    each = before / len(some) * case.count
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return [
        ("one by one, one core, prepared", one, ""),
        (f"one by one, all {cores} cores, prepared", many, ""),
        ("one by one, one core, whole", one + each, ""),
    ], readings


def side_by_side(
    case: Case, device: str, wanted: list[np.ndarray]
) -> Iterator[tuple[str, float, str]]:
    """Seconds of all simulations by JAX on a device, row by row."""
    repeats = 1 if device == "cpu" else 3
    kinds = (("records", False, ()), ("seeds", True, ()), (f"seeds, {len(BY)} slopes", True, BY))
    for kind, shared, slopes in kinds:
        both, alone = case.prepared(device, shared, slopes)
        first, motion = clocked(both, 1)
        told = "" if shared else f"differs by {_difference(motion, wanted):.1e}"
        yield f"{device}, {kind}, on the device", clocked(alone, repeats)[0], told
        again, _ = clocked(both, repeats)
        yield f"{device}, {kind}, prepared", again, ""
        whole, _ = clocked(lambda s=shared, by=slopes: case.whole(device, by, s), 1)
        yield f"{device}, {kind}, whole", whole, ""
        yield f"{device}, {kind}, compilation", first - again, ""


def _difference(motion: Any, wanted: list[np.ndarray]) -> float:
    mine = np.stack(motion.readings, axis=-1)[: len(wanted)]
    return float(np.abs(mine - np.array(wanted)).max() / np.abs(wanted).max())


def devices() -> list[str]:
    """Kinds of device that JAX finds, processors last; none where JAX is absent."""
    from spiral.engine.batch import import_jax
    from spiral.types.errors import ConfigError

    try:
        jax = import_jax()
    except ConfigError as error:
        print(f"batch: {error.given}; {error.try_.partition(';')[0]}")
        return []
    others = {d.platform for d in jax.devices()} - {"cpu"}
    print(f"batch: JAX {jax.__version__}, {jax.devices()[0].device_kind}")
    if not others:
        print("batch: no graphics card here; processors alone")
    return [*sorted(others), "cpu"]


def main() -> None:
    """Print the table."""
    simulations, samples = (int(a) for a in (*sys.argv[1:], "1000", "3000")[:2])
    if len(sys.argv) == 2:
        samples = 3000
    case = Case(simulations, samples)
    rows, wanted = one_by_one(case)
    unit, load = rows[0][1], os.getloadavg()[0]
    print(f"batch: {simulations} simulations of {samples} samples; load {load:.1f}")
    _print_rows(rows, unit)
    for device in devices():
        _print_rows(side_by_side(case, device, wanted), unit)


def _print_rows(rows: Iterable[tuple[str, float, str]], unit: float) -> None:
    for name, seconds, told in rows:
        print(f"{name:<50}{seconds:>9.3f} s{unit / seconds:>9.2f} times  {told}", flush=True)


if __name__ == "__main__":
    main()
