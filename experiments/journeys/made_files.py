"""Files that a user might bring: a hardening spring in columns of the lab's own, and bad ones."""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit

RATE = 500.0  # Hz


@njit
def _hardening(force: np.ndarray, step: float) -> np.ndarray:
    """x'' + 6 x' + 4000 x + 2e6 x^3 = force by Runge-Kutta; force also holds middles of steps."""
    count = len(force) // 2
    found = np.zeros(count)
    x, v = 0.0, 0.0
    for i in range(count - 1):
        found[i] = x
        sum_x, sum_v, slope_x, slope_v = 0.0, 0.0, 0.0, 0.0
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            at_x, at_v = x + share * step * slope_x, v + share * step * slope_v
            push = force[2 * i + (stage + 1) // 2]
            slope_x, slope_v = at_v, push - 6 * at_v - 4000 * at_x - 2e6 * at_x**3
            weight = 1.0 if stage in (0, 3) else 2.0
            sum_x, sum_v = sum_x + weight * slope_x, sum_v + weight * slope_v
        x, v = x + step * sum_x / 6, v + step * sum_v / 6
    found[count - 1] = x
    return found


def hardening_rows(samples: int, seed: int) -> np.ndarray:
    """Time, position with 1 % of noise, and force of a spring that hardens; SI."""
    rng = np.random.default_rng(seed)
    time = np.arange(2 * samples) / (2 * RATE)
    force = np.zeros(2 * samples)
    for hertz in np.arange(2.0, 20.0, 0.7):
        force += 12 * np.sin(2 * np.pi * hertz * time + rng.uniform(0, 2 * np.pi))
    x = _hardening(force, 1 / RATE)
    x += 0.01 * x.std() * rng.normal(size=samples)
    return np.column_stack([time[::2], x, force[::2]])


def write_rows(target: Path, rows: np.ndarray, head: str = "t,x,force") -> Path:
    """A text file of columns."""
    between = ";" if ";" in head else ","
    np.savetxt(target, rows, "%.9g", delimiter=between, header=head, comments="")
    return target


def rig(folder: Path, seed: int = 1) -> Path:
    """3000 rows whose columns have names of their own: milliseconds, micrometres, newton."""
    rows = hardening_rows(3000, seed) * [1e3, 1e6, 1.0]
    return write_rows(folder / f"rig{seed}.csv", rows, "clock;probe 1;hammer")


def lost_readings(folder: Path) -> Path:
    """Two readings that the logger lost."""
    target = write_rows(folder / "gap.csv", hardening_rows(3000, 1))
    lines = target.read_text().splitlines()
    for row in (801, 802):
        time, _, force = lines[row].split(",")
        lines[row] = f"{time},,{force}"
    target.write_text("\n".join(lines))
    return target


def _object_array() -> bytes:
    target = io.BytesIO()
    np.savez(target, x=np.array([{"a": 1}, None], dtype=object))
    return target.getvalue()


def bad_files(folder: Path) -> list[Path]:
    """Eleven files that are no record as they stand."""
    good = hardening_rows(1500, 1)
    clock = good.copy()
    clock[900:, 0] -= 1.0
    uneven = good.copy()
    uneven[:, 0] = np.cumsum(np.random.default_rng(2).uniform(0.002, 0.006, len(good)))
    still = good.copy()
    still[:, 1] = 1.5
    text = write_rows(folder / "text-in-numbers.csv", good)
    lines = text.read_text().splitlines()
    lines[702] = lines[702].replace(lines[702].split(",")[1], "overload")
    text.write_text("\n".join(lines))
    made: dict[str, bytes] = {
        "empty.csv": b"",
        "words.csv": b"name,colour\na,red\nb,blue\n",
        "picture.csv": b"\x89PNG\r\n\x1a\n" + zlib.compress(bytes(range(256)) * 40, 0),
        "cut.mat": _cut_matlab(good),
        "objects.npz": _object_array(),
    }
    for name, content in made.items():
        (folder / name).write_bytes(content)
    written: list[tuple[str, np.ndarray]] = [
        ("clock-back.csv", clock), ("uneven.csv", uneven), ("constant.csv", still),
        ("short.csv", good[:8]),
    ]  # fmt: skip
    for name, rows in written:
        write_rows(folder / name, rows)
    names = [*made, *(name for name, _ in written), text.name]
    return [*(folder / name for name in names), lost_readings(folder)]


def _cut_matlab(rows: np.ndarray) -> bytes:
    """The first half of a MATLAB file."""
    from scipy.io import savemat

    target = io.BytesIO()
    save: Callable[..., None] = savemat
    save(target, {"t": rows[:, 0], "x": rows[:, 1]})
    return target.getvalue()[: len(target.getvalue()) // 2]
